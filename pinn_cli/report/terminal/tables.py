"""The tables of a run as text: sensors, parameters, the sampling of a posterior, fitness, and the free run."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from functools import partial

import numpy as np
import pandas as pd

from pinn_cli.record.response import GROUND, QUANTITIES, RESPONSE_QUANTITIES, UNITS
from pinn_cli.report.fitness import FORMULAS
from pinn_cli.report.free_run import FreeRun
from pinn_cli.report.parameters import worst_sampled
from pinn_cli.report.record_report import EstimatorTables
from pinn_cli.report.terminal.columns import WIDTH, Column, count, interval, marked_lines, number, percent, table_lines
from pinn_cli.report.validation_run import ValidationRun
from pinn_cli.system.quantities import SUPPORT

SENSORS_SHOWN, PARAMETERS_SHOWN, WARNINGS_SHOWN = 24, 24, 12
PRESCRIBED_BESIDE_UNKNOWN = 8  # what was prescribed is not what such a run is made for
DOFS_SHOWN = 10  # beyond these the rows of single DOFs are left to fitness.csv

_TWO, _THREE, _FOUR = (partial(number, digits=digits) for digits in (2, 3, 4))
_SENSORS = {
    "sensor": Column("sensor", -16, str),
    "unit": Column("unit", -6, str),
    "residual_rms": Column("residual rms", 13, _FOUR),
    "sigma": Column("noise", 11, _FOUR),
    "nmse_percent": Column("NMSE (%)", 9, _THREE),
    "free_run_nmse_percent": Column("free run (%)", 13, _THREE),
    "band_share_percent": Column("in band (%)", 12, percent),
}
_OF_SENSORS = (
    "noise: standard deviation found; NMSE: mean square residual over the sensor's variance (0: perfect,",
    "100: predicts nothing); free run: the same of the estimated system under the measured force;",
    "in band: share of the sensor's power where it stands out of its noise; more: residuals.csv",
)
_VALIDATION = {
    "sensor": Column("validation data", -18, str),
    "unit": Column("unit", -6, str),
    "signal_rms": Column("signal rms", 13, _FOUR),
    "error_rms": Column("error rms", 13, _FOUR),
    "nmse_percent": Column("NMSE (%)", 10, _THREE),
    "band_rms": Column("band", 11, _FOUR),
    "inside_95_percent": Column("inside (%)", 12, percent),
}
_PARAMETERS = {
    "estimate": Column("estimate", 12, number),
    "std": Column("std", 10, _TWO),
    "interval": Column("90 % interval", 25, str),
}
_TRUTH = {"true": Column("true", 12, number), "error_percent": Column("error (%)", 10, percent)}
_DIAGNOSTICS = {
    "parameter": Column("parameter", -12, str),
    "mean": Column("mean", 11, number),
    "std": Column("std", 10, _TWO),
    "interval": Column("90 % interval", 25, str),
    "r_hat": Column("R-hat", 8, _FOUR),
    "ess_bulk": Column("bulk ESS", 10, count),
    "ess_tail": Column("tail ESS", 10, count),
    "mcse_mean": Column("MCSE", 10, _TWO),
}
_HEADINGS = {"displacement": "displ.", "velocity": "veloc.", "acceleration": "accel.", "force": "force"}
_TITLES = ("fitness, printed formula (%)", "fitness by range, as in the tables (%)")
_NAME, _CELL, _GAP = 12, 9, "   "


def sensors_text(records: Sequence[EstimatorTables], baseline: EstimatorTables | None = None) -> str:
    """What is left of every sensor beside the noise found, sensor by sensor; of many, of those with the largest NMSE.

    Args:
        records: Of one run, each with its residuals.
        baseline: Another estimator of the only record, whose NMSE stands beside ours.
    """
    every = [tables.residuals.assign(record=i) for i, tables in enumerate(records, start=1)]
    table, columns = pd.concat(every, ignore_index=True), dict(_SENSORS)
    # ``acceleration 3``, ``ground``, ``support 1`` or the name of a sensor that feels something else.
    quantity = table["quantity"].where(~table["quantity"].isin(list(SUPPORT)), "support")
    own = table["channel"].str.rsplit(" ", n=1).str[-1]
    named = (quantity + " " + table["dof"].astype(str)).where(table["dof"].notna(), own)
    named = named.where((table["quantity"] != GROUND) | table["dof"].isna(), "ground")
    shown = table.assign(sensor=named, unit=table["quantity"].map(UNITS))
    if baseline is not None:
        # Both have the same sensors in the same order.
        shown["baseline"] = baseline.residuals["nmse_percent"].to_numpy()
        columns["baseline"] = Column(f"{baseline.name} (%)", len(baseline.name) + 5, _THREE)
    if len(records) > 1:
        columns = {"record": Column("record", -7, str), **columns}
    # There may be no free run, and a training may find no noise.
    lines, notes = _sensor_lines(columns, shown, "residuals.csv")
    return "\n".join([*lines, *notes, *_OF_SENSORS])


def validation_text(run: ValidationRun, table: pd.DataFrame) -> str:
    """Sensor by sensor how far the identified system is from other data, with the table of its run on them."""
    if run.response is None:
        return f"no validation on other data: {run.finding}"
    times = f"{run.record.time[run.first]:.6g} to {run.record.time[-1]:.6g} s"
    begins = "at rest" if run.at_rest else "where the estimate ends"
    notes = [
        f"the identified system under the measured force, {times}, beginning {begins}; band: its standard",
        "deviation (parameters, start, force, discrepancy as a random force); inside: samples within 95 %",
    ]
    shown = table.assign(sensor=table["quantity"] + " " + table["dof"].astype(str))
    lines, left_out = _sensor_lines(_VALIDATION, shown, "validation.csv")
    return "\n".join([*lines, *notes, *left_out])


def _sensor_lines(columns: dict[str, Column], sensors: pd.DataFrame, file: str) -> tuple[list[str], list[str]]:
    """A table of sensors without columns of nothing but dashes, and a note where sensors are left to the file."""
    shown, notes = sensors, []
    if len(sensors) > SENSORS_SHOWN:
        shown = sensors.loc[sensors["nmse_percent"].nlargest(SENSORS_SHOWN).index.sort_values()]
        notes = [f"the {len(shown)} of {len(sensors)} sensors with the largest NMSE; all: {file}"]
    told = {name: column for name, column in columns.items() if shown[name].notna().any()}
    return table_lines(told, shown), notes


def parameters_text(table: pd.DataFrame, warnings: Sequence[str] = (), baseline: EstimatorTables | None = None) -> str:
    """The parameter table: every unknown parameter, then the prescribed ones, or those of them that moved furthest.

    Args:
        table: From `pinn_cli.report.parameters.parameter_table`, of one run: what has a ``start`` was unknown.
        warnings: From `pinn_cli.report.parameters.identifiability_warnings`, of the same run.
        baseline: Of another estimator. Where the truth is known it leaves no room for its parameters.

    Returns:
        Text, or "" if there are no parameters.
    """
    if table.empty:
        return ""
    table, columns = _with_interval(table), dict(_PARAMETERS)
    if table["true"].notna().any():
        columns |= _TRUTH
    elif baseline is not None and len(baseline.parameters):
        theirs = table[["parameter"]].merge(baseline.parameters, on="parameter", how="left").set_index(table.index)
        table = table.assign(baseline_estimate=theirs["estimate"], baseline_std=theirs["std"])
        columns["baseline_estimate"] = Column(baseline.name, max(12, len(baseline.name) + 1), number)
        columns["baseline_std"] = Column("std", 10, _TWO)
    sought = table["start"].notna()
    found = table[sought].assign(parameter=table.loc[sought, "parameter"] + " *")
    prescribed, notes = _furthest_moved(table[~sought], PRESCRIBED_BESIDE_UNKNOWN if len(found) else PARAMETERS_SHOWN)
    lines: list[str] = []
    for given, rows in (("start", found), ("prescribed", prescribed)):
        if len(rows):
            first = {"parameter": Column("parameter", -12, str), given: Column(given, 12, number)}
            head, rule, *cells = table_lines(first | columns, rows)
            lines += [*([rule] if lines else []), head, rule, *cells]
    lines += notes
    if len(found):
        lines += ["* unknown: identified from the record; start is where the search for it began"]
        more = [f"and {len(warnings) - WARNINGS_SHOWN} more: identifiability.csv"]
        told = [*warnings[:WARNINGS_SHOWN], *(more if len(warnings) > WARNINGS_SHOWN else [])]
        lines += [line for sentence in told for line in marked_lines(sentence)]
        lines += [] if warnings else ["every unknown parameter is well determined"]
    return "\n".join(lines)


def _with_interval(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(interval=[interval(*ends) for ends in table[["lower_90", "upper_90"]].to_numpy()])


def _furthest_moved(table: pd.DataFrame, limit: int) -> tuple[pd.DataFrame, list[str]]:
    """The ``limit`` rows that moved furthest, in their order, and a note where that is not all."""
    if len(table) <= limit:
        return table, []
    moved = (table["estimate"] / table["prescribed"] - 1.0).abs()
    kept = table.loc[moved.nlargest(limit).index.sort_values()]
    note = f"the {len(kept)} of {len(table)} that moved furthest from their prescribed values; all: parameters.csv"
    return kept, [note]


def diagnostics_text(diagnostics: pd.DataFrame, verdict: Sequence[str] = ()) -> str:
    """How well the posterior was sampled, parameter by parameter, and whether that is good enough.

    ``verdict`` says why it is not, in a sentence each. Of many parameters those with the fewest effective draws are
    shown; ``diagnostics`` has the columns of `pinn_cli.report.parameters.DIAGNOSTICS`.
    """
    table, notes = _with_interval(diagnostics), []
    if len(table) > PARAMETERS_SHOWN:
        table = table[table["parameter"].isin(worst_sampled(table, PARAMETERS_SHOWN))]
        notes = [f"the {len(table)} of {len(diagnostics)} with the fewest effective draws; all: diagnostics.csv"]
    quality = [line for finding in verdict for line in marked_lines(f"quality check FAILED: {finding}")]
    if not verdict and diagnostics["r_hat"].notna().any():
        quality = ["quality check of the sampling passed"]
    elif not verdict:
        quality = ["no chains, so nothing to check: these are independent draws"]
    return "\n".join([*table_lines(_DIAGNOSTICS, table), *notes, *quality])


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
    names = list(dict.fromkeys(known["group"]))
    single = [name for name in names if name.startswith("dof_")]
    shown = names if len(single) <= DOFS_SHOWN else [name for name in names if name not in single]
    unobserved = [] if observed is None else [f"dof_{i}" for i in np.flatnonzero(~np.asarray(observed)) + 1]
    lines = []
    for name in shown:
        scores = table[table["group"] == name].set_index("quantity").loc[quantities, list(FORMULAS)]
        lines.append(_row(f"{name} *" if name in unobserved else name, *scores.to_numpy().T))
        paper = None if published is None else published[published["group"] == name]
        if paper is not None and len(paper):
            lines.append(_row("  published", [], paper.groupby("quantity")[FORMULAS[0]].mean().reindex(quantities)))
    notes = [] if shown == names else [f"{single[0]} to {single[-1]}: fitness.csv"]
    if any(name in unobserved for name in shown):
        notes.append("* no response sensor on this DOF")
    return "\n".join([*_head("DOFs", quantities), *lines, *notes])


def free_run_line(run: FreeRun, table: pd.DataFrame) -> str:
    """What was found of the free run, or else how far its displacements agree with the estimate, in a sentence."""
    row = table[(table["against"] == "estimate") & (table["group"] == "all") & (table["quantity"] == "displacement")]
    agreement = percent(float(row["fitness_percent"].iloc[0]))
    agrees = f"the free run's displacements agree with the estimate's to {agreement} % (mean over DOFs)"
    return textwrap.fill(run.finding or agrees, WIDTH)


def free_run_text(run: FreeRun, table: pd.DataFrame) -> str:
    """The free run's fitness over all DOFs against truth, sensors and estimate, and what was found of it.

    The sensors are left out where the whole truth is known, and quantities of which neither knows anything.
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
    """Both estimators' fitness over all DOFs and their seconds, ``estimate`` and ``baseline``, in 100 columns.

    Quantities that nobody can score are left out; of a record without any truth the seconds are left.
    """
    both = ((ours, "estimate"), (theirs, "baseline"))
    used = {each.name: f"{seconds[stage]:.1f}" if stage in seconds else "-" for each, stage in both}
    every = {each.name: each.fitness[each.fitness["group"] == "all"].set_index("quantity") for each, _ in both}
    known = [q for q in QUANTITIES if any(table.loc[q, list(FORMULAS)].notna().any() for table in every.values())]
    if not known:
        return "seconds: " + ", ".join(f"{each} {taken}" for each, taken in used.items())
    titles, width = ("mean over DOFs, printed formula (%)", "by range, as in the tables (%)"), 16
    lines = _head("estimator", known, titles, width, last=f"{'seconds':>{_CELL}}")
    for name, table in every.items():
        scores = table.loc[known, list(FORMULAS)].to_numpy(dtype=float).T
        lines.append(_row(name, *scores, width=width, last=f"{used[name]:>{_CELL}}"))
    return "\n".join(lines)


def _head(
    first: str, quantities: Sequence[str], titles: Sequence[str] = _TITLES, width: int = _NAME, last: str = ""
) -> list[str]:
    half = _CELL * len(QUANTITIES)
    headings = f"{''.join(f'{_HEADINGS[quantity]:>{_CELL}}' for quantity in quantities):<{half}}"
    columns = f"{first:<{width}}" + _GAP.join([headings] * len(titles)) + last
    return [" " * width + _GAP.join(f"{title:>{half}}" for title in titles), columns.rstrip(), "-" * len(columns)]


def _row(name: str, *halves: Iterable[float], width: int = _NAME, last: str = "") -> str:
    half = _CELL * len(QUANTITIES)
    cells = [f"{''.join(f'{percent(value):>{_CELL}}' for value in values):<{half}}" for values in halves]
    return (f"{name:<{width}}" + _GAP.join(cells) + last).rstrip()
