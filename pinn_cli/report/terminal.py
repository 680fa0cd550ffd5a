"""What a run prints at its end: the fitness and the parameters as plain text that fits 100 columns."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from pinn_cli.record.record import QUANTITIES, RESPONSE_QUANTITIES
from pinn_cli.report.fitness import FORMULAS
from pinn_cli.report.posterior_table import worst_sampled

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    import pandas as pd

    from pinn_cli.report.free_run import FreeRun
    from pinn_cli.verdict.judge import Verdict

WIDTH = 100
DOFS_SHOWN = 10  # beyond these the rows of single DOFs are left to fitness.csv
PARAMETERS_SHOWN = 24
PRESCRIBED_BESIDE_UNKNOWN = 8  # what was prescribed is not what such a run is made for
WARNINGS_SHOWN = 12
MARK = "! "

_HEADINGS = {"displacement": "displ.", "velocity": "veloc.", "acceleration": "accel.", "force": "force"}
_TITLES = {"fitness_percent": "fitness, printed formula", "range_fitness_percent": "fitness by range, as in the tables"}
_NAME, _CELL, _GAP = 12, 9, "   "


def verdict_text(verdict: Verdict) -> str:
    """The verdict in one line; what is not sound has its reasons above it, one after the other.

    The line is the last but one of a run, whose last is the directory.
    """
    reasons = [reason for finding in verdict.reasons for reason in _folded(finding.text)]
    return "\n".join([*reasons, f"verdict: {verdict.word}"])


def _folded(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent="- ", subsequent_indent="  ", break_on_hyphens=False)


def fitness_text(table: pd.DataFrame, observed: np.ndarray | None = None, published: pd.DataFrame | None = None) -> str:
    """The fitness table with groups as rows and quantities as columns, both formulas side by side, in percent.

    Args:
        table: From `pinn_cli.report.fitness.fitness_table`, of one run.
        observed: (dof,) bool; marks the rows of unobserved DOFs with an asterisk.
        published: From `pinn_cli.report.published.fitness`; the rows of this run's case are printed under their groups.
    """
    scores = table.set_index(["group", "quantity"])[list(FORMULAS)]
    names = list(dict.fromkeys(table["group"]))
    single = [name for name in names if name.startswith("dof_")]
    shown = names if len(single) <= DOFS_SHOWN else [name for name in names if name not in single]
    paper = _published_scores(table, published)
    lines = []
    for name in shown:
        halves = [[float(scores.loc[(name, quantity), formula]) for quantity in QUANTITIES] for formula in FORMULAS]
        lines.append(_row(_marked(name, observed), *halves))
        if name in paper:
            lines.append(_row("  published", [], paper[name]))
    notes = [] if shown == names else [f"dof_1 to dof_{len(single)}: fitness.csv"]
    if observed is not None and shown == names and not np.all(observed):
        notes.append("* no response sensor on this DOF")
    return "\n".join([*_head(), *lines, *notes])


def free_run_text(run: FreeRun, table: pd.DataFrame) -> str:
    """The free run's fitness over all DOFs against truth, sensors and estimate, and what was found of it.

    Args:
        run: The free run.
        table: From `pinn_cli.report.free_run.free_run_table`, of this run. The sensors are left out where the whole
            truth is known.
    """
    finding = textwrap.fill(run.finding, WIDTH)
    if run.response is None:
        return finding
    every = table[table["group"] == "all"].set_index(["against", "quantity"])[list(FORMULAS)]
    lines = []
    for name in dict.fromkeys(table["against"]):
        scores = every.loc[name].reindex(list(RESPONSE_QUANTITIES)).to_numpy().T
        if np.isfinite(scores).any() and not (name == "sensors" and np.isfinite(every.loc["truth"].to_numpy()).all()):
            lines.append(_row(name, *scores))
    title = "free run: the estimated system from its estimated start under the measured force; mean over DOFs"
    return "\n".join([title, *_head("against", RESPONSE_QUANTITIES), *lines, *([finding] if finding else [])])


def _head(first: str = "DOFs", quantities: Sequence[str] = QUANTITIES) -> list[str]:
    half = _CELL * len(QUANTITIES)
    titles = _GAP.join(f"{_TITLES[formula] + ' (%)':>{half}}" for formula in FORMULAS)
    headings = f"{''.join(f'{_HEADINGS[quantity]:>{_CELL}}' for quantity in quantities):<{half}}"
    columns = f"{first:<{_NAME}}" + _GAP.join([headings] * len(FORMULAS))
    return [" " * _NAME + titles, columns.rstrip(), "-" * len(columns)]


def _row(name: str, *halves: Iterable[float]) -> str:
    half_width = _CELL * len(QUANTITIES)
    cells = [f"{''.join(f'{percent(value):>{_CELL}}' for value in half):<{half_width}}" for half in halves]
    return (f"{name:<{_NAME}}" + _GAP.join(cells)).rstrip()


def percent(value: float) -> str:
    """A fitness or an error in per cent, short also where it is far off; a dash where there is none."""
    if not np.isfinite(value):
        return "-"
    return f"{value:.2f}" if abs(value) < 1e4 else f"{value:.0e}"


def _marked(name: str, observed: np.ndarray | None) -> str:
    if observed is None or not name.startswith("dof_"):
        return name
    return name if observed[int(name.removeprefix("dof_")) - 1] else f"{name} *"


def _published_scores(table: pd.DataFrame, published: pd.DataFrame | None) -> dict[str, list[float]]:
    """Group to the paper's values in the order of the quantities, for the case that ``table`` is of."""
    if published is None or table.empty:
        return {}
    rows = published[published["case"] == table["case"].iloc[0]]
    return {
        str(group): [float(part.loc[part["quantity"] == quantity, "fitness_percent"].mean()) for quantity in QUANTITIES]
        for group, part in rows.groupby("group")
    }


def parameters_text(table: pd.DataFrame, unknown: Collection[str] = (), warnings: Sequence[str] = ()) -> str:
    """The parameter table: every unknown parameter, then the prescribed ones, or those of them that moved furthest.

    Args:
        table: From `pinn_cli.report.parameters.parameter_table`, of one run.
        unknown: Names of those that were to be identified from the record; the others were prescribed.
        warnings: From `pinn_cli.report.identifiability.identifiability_warnings`, of the same run.

    Returns:
        Text, or "" if there are no parameters.
    """
    if table.empty:
        return ""
    table = table.assign(interval=[_interval(*bounds) for bounds in table[["lower_90", "upper_90"]].to_numpy()])
    sought = table["parameter"].isin(list(unknown))
    found = table[sought].assign(parameter=table.loc[sought, "parameter"] + " *")
    prescribed, notes = _furthest_moved(table[~sought], PRESCRIBED_BESIDE_UNKNOWN if len(found) else PARAMETERS_SHOWN)
    head = _head_of(_COLUMNS)
    rule = "-" * len(head)
    lines = [head, rule, *_rows_of(_COLUMNS, found)]
    if len(found) and len(prescribed):
        lines.append(rule)
    lines += [*_rows_of(_COLUMNS, prescribed), *notes]
    if len(found):
        lines += ["* unknown: identified from the record; its prescribed value is where it started", *_marks(warnings)]
    return "\n".join(lines)


def _furthest_moved(table: pd.DataFrame, limit: int) -> tuple[pd.DataFrame, list[str]]:
    """The ``limit`` rows that moved furthest, in their order, and a note where that is not all."""
    if len(table) <= limit:
        return table, []
    moved = (table["estimate"] / table["prescribed"] - 1.0).abs()
    kept = table.loc[moved.nlargest(limit).index.sort_values()]
    note = f"the {len(kept)} of {len(table)} that moved furthest from their prescribed values; all: parameters.csv"
    return kept, [note]


def _marks(warnings: Sequence[str]) -> list[str]:
    """One line per warning; of a long chain's, the first `WARNINGS_SHOWN`."""
    if not warnings:
        return ["every unknown parameter is well determined"]
    sentences = list(warnings[:WARNINGS_SHOWN])
    if len(warnings) > WARNINGS_SHOWN:
        sentences.append(f"and {len(warnings) - WARNINGS_SHOWN} more: identifiability.csv")
    return [line for sentence in sentences for line in _marked_lines(sentence)]


def _marked_lines(sentence: str) -> list[str]:
    return textwrap.wrap(sentence, WIDTH, initial_indent=MARK, subsequent_indent=" " * len(MARK))


def diagnostics_text(diagnostics: pd.DataFrame, verdict: Sequence[str] = ()) -> str:
    """How well the posterior was sampled, parameter by parameter, and whether that is good enough.

    Args:
        diagnostics: With the columns of `pinn_cli.report.posterior_table.DIAGNOSTICS`; of more than `PARAMETERS_SHOWN`
            parameters, those with the fewest effective draws are shown.
        verdict: Why the quality check failed, one sentence each; none if it passed.
    """
    table = diagnostics.assign(
        interval=[_interval(*bounds) for bounds in diagnostics[["lower_90", "upper_90"]].to_numpy()]
    )
    notes = []
    if len(table) > PARAMETERS_SHOWN:
        table = table[table["parameter"].isin(worst_sampled(table, PARAMETERS_SHOWN))]
        notes.append(f"the {len(table)} of {len(diagnostics)} with the fewest effective draws; all: diagnostics.csv")
    head = _head_of(_DIAGNOSTICS)
    return "\n".join([head, "-" * len(head), *_rows_of(_DIAGNOSTICS, table), *notes, *_quality(diagnostics, verdict)])


def _quality(diagnostics: pd.DataFrame, verdict: Sequence[str]) -> list[str]:
    if verdict:
        return [line for finding in verdict for line in _marked_lines(f"quality check FAILED: {finding}")]
    if not diagnostics["r_hat"].notna().any():
        return ["no chains, so nothing to check: these are independent draws"]
    return ["quality check of the sampling passed"]


def _number(value: float, digits: int = 5) -> str:
    """A number with ``digits`` significant digits, and an exponent only where it would be long without one."""
    if not np.isfinite(value):
        return "-"
    order = math.floor(math.log10(abs(value))) if value else 0
    if not -5 < order < 7:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(digits - 1 - order, 0)}f}"


def _count(value: float) -> str:
    return f"{value:.0f}" if np.isfinite(value) else "-"


def _interval(lower: float, upper: float) -> str:
    return f"{_number(lower)} to {_number(upper)}" if np.isfinite(lower) and np.isfinite(upper) else "-"


@dataclass(frozen=True)
class _Column:
    title: str
    width: int
    text: Callable[[Any], str]

    def align(self, text: str) -> str:
        return f"{text:>{self.width}}" if self.width > 0 else f"{text:<{-self.width}}"

    def write(self, value: object) -> str:
        return self.align(self.text(value))


_COLUMNS = {
    "parameter": _Column("parameter", -12, str),
    "prescribed": _Column("prescribed", 12, _number),
    "estimate": _Column("estimate", 12, _number),
    "std": _Column("std", 10, partial(_number, digits=2)),
    "interval": _Column("90 % interval", 25, str),
    "true": _Column("true", 12, _number),
    "error_percent": _Column("error (%)", 10, percent),
}
_DIAGNOSTICS = {
    "parameter": _Column("parameter", -12, str),
    "mean": _Column("mean", 11, _number),
    "std": _Column("std", 10, partial(_number, digits=2)),
    "interval": _Column("90 % interval", 25, str),
    "r_hat": _Column("R-hat", 8, partial(_number, digits=4)),
    "ess_bulk": _Column("bulk ESS", 10, _count),
    "ess_tail": _Column("tail ESS", 10, _count),
    "mcse_mean": _Column("MCSE", 10, partial(_number, digits=2)),
}


def _head_of(columns: Mapping[str, _Column]) -> str:
    return "".join(column.align(column.title) for column in columns.values())


def _rows_of(columns: Mapping[str, _Column], table: pd.DataFrame) -> list[str]:
    return ["".join(columns[name].write(row[name]) for name in columns) for row in table.to_dict(orient="records")]
