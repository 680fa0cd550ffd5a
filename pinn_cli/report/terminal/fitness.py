"""The fitness as text: groups of DOFs as rows, quantities as columns."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES
from pinn_cli.report.fitness import FORMULAS
from pinn_cli.report.terminal.columns import WIDTH, percent

if TYPE_CHECKING:
    import pandas as pd

    from pinn_cli.report.free_run import FreeRun
    from pinn_cli.report.record_report import EstimatorTables

DOFS_SHOWN = 10  # beyond these the rows of single DOFs are left to fitness.csv

_HEADINGS = {"displacement": "displ.", "velocity": "veloc.", "acceleration": "accel.", "force": "force"}
_TITLES = ("fitness, printed formula (%)", "fitness by range, as in the tables (%)")
_NAME, _CELL, _GAP = 12, 9, "   "


def fitness_text(table: pd.DataFrame, observed: np.ndarray | None = None, published: pd.DataFrame | None = None) -> str:
    """The fitness table with groups as rows and quantities as columns, both formulas side by side, in percent.

    Groups and quantities of which nothing is known are left out: a measured record has a truth at held-out DOFs only.

    Args:
        table: From `pinn_cli.report.fitness.fitness_table`, of one run.
        observed: (dof,) bool; marks the rows of unobserved DOFs with an asterisk.
        published: From `pinn_cli.report.published.fitness_of`; its rows are printed under their groups.

    Returns:
        Text, or "" if there is no number at all.
    """
    known = table[np.isfinite(table[list(FORMULAS)]).any(axis=1)]
    if known.empty:
        return ""
    quantities = [quantity for quantity in QUANTITIES if quantity in set(known["quantity"])]
    scores = table.set_index(["group", "quantity"])[list(FORMULAS)]
    names = list(dict.fromkeys(known["group"]))
    single = [name for name in names if name.startswith("dof_")]
    shown = names if len(single) <= DOFS_SHOWN else [name for name in names if name not in single]
    unobserved = [] if observed is None else [f"dof_{i}" for i in np.flatnonzero(~np.asarray(observed)) + 1]
    lines = []
    for name in shown:
        halves = [[float(scores.loc[(name, quantity), formula]) for quantity in quantities] for formula in FORMULAS]
        lines.append(_row(f"{name} *" if name in unobserved else name, *halves))
        paper = None if published is None else published[published["group"] == name]
        if paper is not None and len(paper):
            values = paper.groupby("quantity")["fitness_percent"].mean().reindex(quantities)
            lines.append(_row("  published", [], values))
    notes = [] if shown == names else [f"{single[0]} to {single[-1]}: fitness.csv"]
    if any(name in unobserved for name in shown):
        notes.append("* no response sensor on this DOF")
    return "\n".join([*_head(quantities=quantities), *lines, *notes])


def free_run_line(run: FreeRun, table: pd.DataFrame) -> str:
    """What was found of the free run, or else how far its displacements agree with the estimated ones, in a sentence.

    Args:
        run: The free run.
        table: From `pinn_cli.report.free_run.free_run_table`, of this run.
    """
    row = table[(table["against"] == "estimate") & (table["group"] == "all") & (table["quantity"] == "displacement")]
    agreement = percent(float(row["fitness_percent"].iloc[0]))
    agrees = f"the free run's displacements agree with the estimate's to {agreement} % (mean over DOFs)"
    return textwrap.fill(run.finding or agrees, WIDTH)


def free_run_text(run: FreeRun, table: pd.DataFrame) -> str:
    """The free run's fitness over all DOFs against truth, sensors and estimate, and what was found of it.

    The sensors are left out where the whole truth is known, and quantities of which neither truth nor sensors know
    anything.

    Args:
        run: The free run.
        table: From `pinn_cli.report.free_run.free_run_table`, of this run.
    """
    finding = textwrap.fill(run.finding, WIDTH)
    if run.response is None:
        return finding
    every = table[table["group"] == "all"].set_index(["against", "quantity"])[list(FORMULAS)]
    quantities = [q for q in RESPONSE_QUANTITIES if every.loc[[("truth", q), ("sensors", q)]].notna().any(axis=None)]
    lines = []
    for name in dict.fromkeys(table["against"]):
        scores = every.loc[name].reindex(quantities).to_numpy().T
        if np.isfinite(scores).any() and not (name == "sensors" and np.isfinite(every.loc["truth"].to_numpy()).all()):
            lines.append(_row(name, *scores))
    title = "free run: the estimated system from its estimated start under the measured force; mean over DOFs"
    return "\n".join([title, *_head("against", quantities), *lines, *([finding] if finding else [])])


def comparison_text(ours: EstimatorTables, theirs: EstimatorTables, seconds: Mapping[str, float]) -> str:
    """Both estimators' fitness over all DOFs and their seconds, in 100 columns.

    Quantities that nobody can score are left out; of a record without any truth the seconds are left.

    Args:
        ours: The network's tables.
        theirs: The baseline's.
        seconds: By stage: ``estimate`` and ``baseline``.
    """
    stages = {ours.name: "estimate", theirs.name: "baseline"}
    used = {each: f"{seconds[stage]:.1f}" if stage in seconds else "-" for each, stage in stages.items()}
    every = {
        each.name: each.fitness[each.fitness["group"] == "all"].set_index("quantity")[list(FORMULAS)]
        for each in (ours, theirs)
    }
    known = [q for q in QUANTITIES if any(np.isfinite(table.loc[q]).any() for table in every.values())]
    if not known:
        return "seconds: " + ", ".join(f"{each} {taken}" for each, taken in used.items())
    titles = ("mean over DOFs, printed formula (%)", "by range, as in the tables (%)")
    head = _head("estimator", known, titles, width=16, last=f"{'seconds':>{_CELL}}")
    rows = [
        _row(each, *table.loc[known].to_numpy().T, width=16, last=f"{used[each]:>{_CELL}}")
        for each, table in every.items()
    ]
    return "\n".join([*head, *rows])


def _head(
    first: str = "DOFs",
    quantities: Sequence[str] = QUANTITIES,
    titles: Sequence[str] = _TITLES,
    width: int = _NAME,
    last: str = "",
) -> list[str]:
    half = _CELL * len(QUANTITIES)
    headings = f"{''.join(f'{_HEADINGS[quantity]:>{_CELL}}' for quantity in quantities):<{half}}"
    columns = f"{first:<{width}}" + _GAP.join([headings] * len(titles)) + last
    return [" " * width + _GAP.join(f"{title:>{half}}" for title in titles), columns.rstrip(), "-" * len(columns)]


def _row(name: str, *halves: Iterable[float], width: int = _NAME, last: str = "") -> str:
    half = _CELL * len(QUANTITIES)
    cells = [f"{''.join(f'{percent(value):>{_CELL}}' for value in values):<{half}}" for values in halves]
    return (f"{name:<{width}}" + _GAP.join(cells) + last).rstrip()
