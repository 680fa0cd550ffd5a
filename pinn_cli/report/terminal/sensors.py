"""The sensors as text: what the estimate leaves of each, and how far the identified system is from other data."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import pandas as pd

from pinn_cli.record.response import GROUND, UNITS
from pinn_cli.report.terminal.columns import Column, number, percent, table_lines
from pinn_cli.system.quantities import SUPPORT

if TYPE_CHECKING:
    from pinn_cli.report.record_report import EstimatorTables
    from pinn_cli.report.validation_run import ValidationRun

SENSORS_SHOWN = 24
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
_VALIDATION_COLUMNS = {
    "sensor": Column("validation data", -18, str),
    "unit": Column("unit", -6, str),
    "signal_rms": Column("signal rms", 13, partial(number, digits=4)),
    "error_rms": Column("error rms", 13, partial(number, digits=4)),
    "nmse_percent": Column("NMSE (%)", 10, partial(number, digits=3)),
    "band_rms": Column("band", 11, partial(number, digits=4)),
    "inside_95_percent": Column("inside (%)", 12, percent),
}


def sensors_text(records: Sequence[EstimatorTables], baseline: EstimatorTables | None = None) -> str:
    """What is left of every sensor beside the noise found, sensor by sensor.

    Args:
        records: Of one run, each with its residuals; of more than `SENSORS_SHOWN` sensors, those with the largest NMSE
            are shown.
        baseline: Another estimator of the only record, whose NMSE stands beside ours.
    """
    columns = dict(_SENSOR_COLUMNS)
    table = pd.concat([tables.residuals.assign(record=i) for i, tables in enumerate(records, start=1)])
    table = table.reset_index(drop=True)
    shown = table.assign(sensor=_sensors(table), unit=table["quantity"].map(UNITS))
    if baseline is not None:
        # Both have the same sensors in the same order.
        shown["baseline"] = baseline.residuals["nmse_percent"].to_numpy()
        title = f"{baseline.name} (%)"
        columns["baseline"] = Column(title, len(title) + 1, partial(number, digits=3))
    if len(records) > 1:
        columns = {"record": Column("record", -7, str), **columns}
    # There may be no free run, and a training may find no noise.
    lines, notes = _sensor_lines(columns, shown, "residuals.csv")
    return "\n".join([*lines, *notes, *_NOTES])


def validation_text(run: ValidationRun, table: pd.DataFrame) -> str:
    """Sensor by sensor how far the identified system is from data that it was not identified from.

    Args:
        run: Of the identified system.
        table: From `pinn_cli.report.validation_run.validation_table`; of more than `SENSORS_SHOWN` sensors, those with
            the largest NMSE are shown.
    """
    if run.response is None:
        return f"no validation on other data: {run.finding}"
    times = f"{run.record.time[run.first]:.6g} to {run.record.time[-1]:.6g} s"
    begins = "at rest" if run.at_rest else "where the estimate ends"
    notes = [
        f"the identified system under the measured force, {times}, beginning {begins}; band: its standard",
        "deviation (parameters, start, force, discrepancy as a random force); inside: samples within 95 %",
    ]
    shown = table.assign(sensor=table["quantity"] + " " + table["dof"].astype(str))
    lines, left_out = _sensor_lines(_VALIDATION_COLUMNS, shown, "validation.csv")
    return "\n".join([*lines, *notes, *left_out])


def _sensor_lines(columns: dict[str, Column], sensors: pd.DataFrame, file: str) -> tuple[list[str], list[str]]:
    """A table of sensors without columns of nothing but dashes, and a note where sensors are left to the file."""
    shown, notes = sensors, []
    if len(sensors) > SENSORS_SHOWN:
        shown = sensors.loc[sensors["nmse_percent"].nlargest(SENSORS_SHOWN).index.sort_values()]
        notes = [f"the {len(shown)} of {len(sensors)} sensors with the largest NMSE; all: {file}"]
    told = {name: column for name, column in columns.items() if shown[name].notna().any()}
    return table_lines(told, shown), notes


def _sensors(table: pd.DataFrame) -> pd.Series:
    """``acceleration 3``, ``ground``, ``support 1`` or the name of a sensor that feels something else, by row."""
    quantity = table["quantity"].where(~table["quantity"].isin(list(SUPPORT)), "support")
    own = table["channel"].str.rsplit(" ", n=1).str[-1]
    named = (quantity + " " + table["dof"].astype(str)).where(table["dof"].notna(), own)
    return named.where((table["quantity"] != GROUND) | table["dof"].isna(), "ground")
