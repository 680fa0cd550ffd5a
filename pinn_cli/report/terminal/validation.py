"""What a run prints of the data that the identified system was tried on."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from pinn_cli.report.terminal.columns import Column, number, percent, sensor_lines

if TYPE_CHECKING:
    import pandas as pd

    from pinn_cli.report.validation_run import ValidationRun

_COLUMNS = {
    "sensor": Column("validation data", -18, str),
    "unit": Column("unit", -6, str),
    "signal_rms": Column("signal rms", 13, partial(number, digits=4)),
    "error_rms": Column("error rms", 13, partial(number, digits=4)),
    "nmse_percent": Column("NMSE (%)", 10, partial(number, digits=3)),
    "band_rms": Column("band", 11, partial(number, digits=4)),
    "inside_95_percent": Column("inside (%)", 12, percent),
}


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
    lines, left_out = sensor_lines(_COLUMNS, shown, "validation.csv")
    return "\n".join([*lines, *notes, *left_out])
