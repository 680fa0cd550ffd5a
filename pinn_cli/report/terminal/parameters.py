"""The parameters as text: what was found of the unknown ones, and how far the prescribed ones moved."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from pinn_cli.report.parameters import worst_sampled
from pinn_cli.report.terminal.columns import Column, count, interval, marked_lines, number, percent, table_lines

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd

PARAMETERS_SHOWN = 24
PRESCRIBED_BESIDE_UNKNOWN = 8  # what was prescribed is not what such a run is made for
WARNINGS_SHOWN = 12


def parameters_text(
    table: pd.DataFrame,
    warnings: Sequence[str] = (),
    baseline: tuple[str, pd.DataFrame] | None = None,
) -> str:
    """The parameter table: every unknown parameter, then the prescribed ones, or those of them that moved furthest.

    Args:
        table: From `pinn_cli.report.parameters.parameter_table`, of one run: what has a ``start`` was unknown.
        warnings: From `pinn_cli.report.parameters.identifiability_warnings`, of the same run.
        baseline: Name and parameter table of another estimator. Where the truth is known it leaves no room for these.

    Returns:
        Text, or "" if there are no parameters.
    """
    if table.empty:
        return ""
    table = table.assign(interval=[interval(*bounds) for bounds in table[["lower_90", "upper_90"]].to_numpy()])
    columns = dict(_COLUMNS)
    if table["true"].notna().any():
        columns |= _TRUTH
    elif baseline is not None and len(baseline[1]):
        table, columns = _with_baseline(table, *baseline)
    sought = table["start"].notna()
    found = table[sought].assign(parameter=table.loc[sought, "parameter"] + " *")
    prescribed, notes = _furthest_moved(table[~sought], PRESCRIBED_BESIDE_UNKNOWN if len(found) else PARAMETERS_SHOWN)
    lines: list[str] = []
    for given, rows in (("start", found), ("prescribed", prescribed)):
        if len(rows):
            head, rule, *cells = table_lines(_given_as(given, columns), rows)
            lines += [*([rule] if lines else []), head, rule, *cells]
    lines += notes
    if len(found):
        lines += ["* unknown: identified from the record; start is where the search for it began", *_marks(warnings)]
    return "\n".join(lines)


def _given_as(name: str, columns: dict[str, Column]) -> dict[str, Column]:
    """The columns with what the estimator was given after the parameter's name."""
    first, *others = columns
    return {first: columns[first], name: Column(name, 12, number), **{other: columns[other] for other in others}}


def _with_baseline(table: pd.DataFrame, name: str, theirs: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, Column]]:
    """Estimate and standard deviation of the same parameter by the baseline."""
    by_name = theirs.set_index("parameter")
    table = table.assign(**{other: table["parameter"].map(by_name[column]) for other, column in _THEIRS.items()})
    estimate, std = _THEIRS
    both = {estimate: Column(name, max(12, len(name) + 1), number), std: Column("std", 10, partial(number, digits=2))}
    return table, _COLUMNS | both


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
    return [line for sentence in sentences for line in marked_lines(sentence)]


def diagnostics_text(diagnostics: pd.DataFrame, verdict: Sequence[str] = ()) -> str:
    """How well the posterior was sampled, parameter by parameter, and whether that is good enough.

    Args:
        diagnostics: With the columns of `pinn_cli.report.parameters.DIAGNOSTICS`; of more than `PARAMETERS_SHOWN`
            parameters, those with the fewest effective draws are shown.
        verdict: Why the quality check failed, one sentence each; none if it passed.
    """
    ends = diagnostics[["lower_90", "upper_90"]].to_numpy()
    table = diagnostics.assign(interval=[interval(*bounds) for bounds in ends])
    notes = []
    if len(table) > PARAMETERS_SHOWN:
        table = table[table["parameter"].isin(worst_sampled(table, PARAMETERS_SHOWN))]
        notes.append(f"the {len(table)} of {len(diagnostics)} with the fewest effective draws; all: diagnostics.csv")
    return "\n".join([*table_lines(_DIAGNOSTICS, table), *notes, *_quality(diagnostics, verdict)])


def _quality(diagnostics: pd.DataFrame, verdict: Sequence[str]) -> list[str]:
    if verdict:
        return [line for finding in verdict for line in marked_lines(f"quality check FAILED: {finding}")]
    if not diagnostics["r_hat"].notna().any():
        return ["no chains, so nothing to check: these are independent draws"]
    return ["quality check of the sampling passed"]


_COLUMNS = {
    "parameter": Column("parameter", -12, str),
    "estimate": Column("estimate", 12, number),
    "std": Column("std", 10, partial(number, digits=2)),
    "interval": Column("90 % interval", 25, str),
}
_TRUTH = {
    "true": Column("true", 12, number),
    "error_percent": Column("error (%)", 10, percent),
}
_THEIRS = {"baseline_estimate": "estimate", "baseline_std": "std"}
_DIAGNOSTICS = {
    "parameter": Column("parameter", -12, str),
    "mean": Column("mean", 11, number),
    "std": Column("std", 10, partial(number, digits=2)),
    "interval": Column("90 % interval", 25, str),
    "r_hat": Column("R-hat", 8, partial(number, digits=4)),
    "ess_bulk": Column("bulk ESS", 10, count),
    "ess_tail": Column("tail ESS", 10, count),
    "mcse_mean": Column("MCSE", 10, partial(number, digits=2)),
}
