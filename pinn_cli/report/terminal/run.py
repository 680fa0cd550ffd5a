"""All that a run prints at its end: of a simulated record its fitness first, of a measured one its sensors."""

from __future__ import annotations

import textwrap
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.record.response import GROUND, UNITS
from pinn_cli.report import published
from pinn_cli.report.fitness import FORMULAS
from pinn_cli.report.parameters import identifiability_warnings
from pinn_cli.report.terminal.columns import WIDTH, Column, number, percent, sensor_lines
from pinn_cli.report.terminal.fitness import comparison_text, fitness_text, free_run_line, free_run_text
from pinn_cli.report.terminal.parameters import parameters_text
from pinn_cli.system.quantities import SUPPORT

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pinn_cli.report.free_run import FreeRun
    from pinn_cli.report.results import Results, RunDescription
    from pinn_cli.report.tables import EstimatorTables
    from pinn_cli.validation.base import Score
    from pinn_cli.verdict.finding import Verdict

_NOTES = (
    "noise: standard deviation found; NMSE: mean square residual over the sensor's variance (0: perfect,",
    "100: predicts nothing); free run: the same of the estimated system under the measured force;",
    "in band: share of the sensor's power where it stands out of its noise; more: residuals.csv",
)
_SENSOR_COLUMNS = {
    "sensor": Column("sensor", -16, str),
    "unit": Column("unit", -6, str),
    "residual_rms": Column("residual rms", 13, partial(number, digits=4)),
    "sigma": Column("noise", 11, partial(number, digits=4)),
    "nmse_percent": Column("NMSE (%)", 9, partial(number, digits=3)),
    "free_run_nmse_percent": Column("free run (%)", 13, partial(number, digits=3)),
    "band_share_percent": Column("in band (%)", 12, percent),
}
SCORE_UNITS = {
    "heldout": "nats per withheld sample, 0 at best",
    "forecast": "log of error over noise, 0 at best",
    "evidence": "nats, up to a constant of the network",
}


def run_text(
    results: Results,
    tables: EstimatorTables,
    baseline: EstimatorTables | None,
    free_run: tuple[FreeRun, pd.DataFrame],
    further_texts: Sequence[str],
    verdict: Verdict | None,
    seconds: Mapping[str, float],
    further: Sequence[EstimatorTables] = (),
) -> str:
    """All that a run prints, in paragraphs that an empty line parts; the verdict comes last.

    A measured record is described sensor by sensor. Its fitness is printed only where sensors were held out, and its
    free run against the sensors only in their table.

    Args:
        results: What came of it, the estimate with its posterior's parameters.
        tables: Of the network.
        baseline: Of the baseline, where there is one.
        free_run: And its table.
        further_texts: Of a posterior, of a validation on other data, of changes; "" without one.
        verdict: Where there is one.
        seconds: By stage.
        further: Tables of the network for further records.
    """
    run, estimate = results.run, results.estimate
    warnings = identifiability_warnings(estimate.before_any_record, estimate.correlation)
    their_parameters = (baseline.name, baseline.parameters) if baseline else None
    known = bool(np.isfinite(tables.fitness[list(FORMULAS)].to_numpy()).any())
    paragraphs = [
        ""
        if run.simulated or tables.residuals.empty
        else sensors_text(_of_records(tables, further), _residuals_of(baseline)),
        parameters_text(tables.parameters, warnings, their_parameters),
        fitness_text(tables.fitness, results.record.observed, _published(run)),
        free_run_text(*free_run) if known else free_run_line(*free_run),
        *further_texts,
        "" if baseline is None else comparison_text(tables.fitness, baseline.name, baseline.fitness, seconds),
        score_text(run.validation, results.score),
        "" if verdict is None else verdict_text(verdict),
    ]
    return "\n\n".join(text for text in paragraphs if text)


def _residuals_of(baseline: EstimatorTables | None) -> tuple[str, pd.DataFrame] | None:
    return (baseline.name, baseline.residuals) if baseline else None


def _published(run: RunDescription) -> pd.DataFrame:
    """The paper's values of the same case; none once a setting that makes it that case was changed."""
    values, labels = published.fitness(), run.labels_of(estimator="pinn")
    same = ["case", "ndof", "nonlinearity", "model_error", "snr_db"]
    return values[(values[same] == [labels[name] for name in same]).all(axis=1)]


def _of_records(first: EstimatorTables, further: Sequence[EstimatorTables]) -> pd.DataFrame:
    """Residuals of all records, with a column that says of which, where there are several."""
    if not further:
        return first.residuals
    numbered = (tables.residuals.assign(record=i) for i, tables in enumerate((first, *further), start=1))
    return pd.concat(numbered, ignore_index=True)


def sensors_text(table: pd.DataFrame, baseline: tuple[str, pd.DataFrame] | None = None) -> str:
    """What is left of every sensor beside the noise found, sensor by sensor.

    Args:
        table: From `pinn_cli.report.residuals.residual_table`, of one run; of more than `SENSORS_SHOWN` sensors, those
            with the largest NMSE are shown.
        baseline: Name and table of another estimator, whose NMSE stands beside ours.
    """
    unit = table["quantity"].map(UNITS)
    columns, shown = (
        dict(_SENSOR_COLUMNS),
        table.assign(sensor=_sensors(table), unit=unit),
    )
    if baseline is not None:
        name, theirs = baseline
        # Both have the same sensors in the same order.
        shown["baseline"] = theirs["nmse_percent"].to_numpy()
        columns["baseline"] = Column(f"{name} (%)", len(name) + 5, partial(number, digits=3))
    if "record" in shown:
        columns = {"record": Column("record", -7, str), **columns}
    # There may be no free run, and a training may find no noise.
    lines, notes = sensor_lines(columns, shown, "residuals.csv")
    return "\n".join([*lines, *notes, *_NOTES])


def _sensors(table: pd.DataFrame) -> pd.Series:
    """``acceleration 3``, ``ground``, ``support 1`` or the name of a sensor that feels something else, by row."""
    quantity = table["quantity"].where(~table["quantity"].isin(list(SUPPORT)), "support")
    own = table["channel"].str.rsplit(" ", n=1).str[-1]
    named = (quantity + " " + table["dof"].astype(str)).where(table["dof"].notna(), own)
    return named.where((table["quantity"] != GROUND) | table["dof"].isna(), "ground")


def score_text(name: str, score: Score | None) -> str:
    """The line of the validation; empty without one."""
    if score is None:
        return ""
    value = f"{score.value:.5g}" if np.isfinite(score.value) else f"none: {score.reason}"
    return f"validation score ({name}; {SCORE_UNITS.get(name, 'lower is better')}): {value}"


def verdict_text(verdict: Verdict) -> str:
    """The verdict in one line, the last but one of a run; what is not sound has its reasons above it."""
    folded = textwrap.TextWrapper(WIDTH, initial_indent="- ", subsequent_indent="  ", break_on_hyphens=False)
    reasons = [folded.fill(finding.text) for finding in verdict.reasons]
    return "\n".join([*reasons, f"verdict: {verdict.word}"])
