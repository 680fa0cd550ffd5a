"""Peaks of a prediction."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import pandas as pd

from pinn_cli.report.terminal.columns import number

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.training.estimate import Peak

COLUMNS = ("quantity", "of", "unit", "peak", "time", "lower_90", "upper_90")
# In the text; all of them stand in the table.
SHOWN = ("drift", "connection_force")
MOST = 20


def peak_table(peaks: Sequence[Peak]) -> pd.DataFrame:
    """One row per history (the content of ``peaks.csv``): `COLUMNS`, in SI units."""
    return pd.DataFrame([asdict(peak) for peak in peaks], columns=list(COLUMNS))


def peaks_text(peaks: Sequence[Peak]) -> str:
    """Peak drifts and forces of the connections; "" without a prediction."""
    if not peaks:
        return ""
    shown = [peak for peak in peaks if peak.quantity in SHOWN]
    lines = [
        f"peak {peak.quantity.replace('_', ' ')} of connection {peak.of}: {number(peak.peak, digits=4)} {peak.unit}"
        f" at {peak.time:.4g} s, 90 %: {number(peak.lower_90, digits=4)} to {number(peak.upper_90, digits=4)}"
        for peak in shown[:MOST]
    ]
    return "\n".join([*lines, f"{len(peaks)} peaks with intervals: peaks.csv"])
