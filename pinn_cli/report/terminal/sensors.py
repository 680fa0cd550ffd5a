"""Every sensor of a measured record against the estimate, as text."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from pinn_cli.record.record import UNITS
from pinn_cli.report.terminal.columns import Column, head_of, number, percent, rows_of

if TYPE_CHECKING:
    import pandas as pd

SENSORS_SHOWN = 24
_NOTES = (
    "noise: standard deviation found; NMSE: mean square residual over the sensor's variance (0: perfect,",
    "100: predicts nothing); free run: the same of the estimated system under the measured force;",
    "in band: share of the sensor's power where it stands out of its noise; more: residuals.csv",
)


def sensors_text(table: pd.DataFrame, baseline: tuple[str, pd.DataFrame] | None = None) -> str:
    """What is left of every sensor beside the noise found, sensor by sensor.

    Args:
        table: From `pinn_cli.report.residuals.residual_table`, of one run; of more than `SENSORS_SHOWN` sensors, those
            with the largest NMSE are shown.
        baseline: Name and table of another estimator, whose NMSE stands beside ours.
    """
    unit = table["quantity"].map(UNITS)
    columns, shown = dict(_COLUMNS), table.assign(sensor=table["quantity"] + " " + table["dof"].astype(str), unit=unit)
    if baseline is not None:
        name, theirs = baseline
        # Both have the same sensors in the same order.
        shown["baseline"] = theirs["nmse_percent"].to_numpy()
        columns["baseline"] = Column(f"{name} (%)", len(name) + 5, partial(number, digits=3))
    notes = []
    if len(shown) > SENSORS_SHOWN:
        shown = shown.loc[shown["nmse_percent"].nlargest(SENSORS_SHOWN).index.sort_values()]
        notes.append(f"the {len(shown)} of {len(table)} sensors with the largest NMSE; all: residuals.csv")
    # A column of dashes says nothing: there may be no free run, and a training may find no noise.
    columns = {name: column for name, column in columns.items() if shown[name].notna().any()}
    head = head_of(columns)
    return "\n".join([head, "-" * len(head), *rows_of(columns, shown), *notes, *_NOTES])


_COLUMNS = {
    "sensor": Column("sensor", -16, str),
    "unit": Column("unit", -6, str),
    "residual_rms": Column("residual rms", 13, partial(number, digits=4)),
    "sigma": Column("noise", 11, partial(number, digits=4)),
    "nmse_percent": Column("NMSE (%)", 9, partial(number, digits=3)),
    "free_run_nmse_percent": Column("free run (%)", 13, partial(number, digits=3)),
    "band_share_percent": Column("in band (%)", 12, percent),
}
