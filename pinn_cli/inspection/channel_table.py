"""What every channel says about itself: gaps, clipping, size, band, noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from pinn_cli.record.channels import clipped_percent, constant_percent
from pinn_cli.record.signal import Sampling, Signal
from pinn_cli.record.spectrum import noise_level, signal_edges, visible_floor

COLUMNS = (
    "channel", "column", "quantity", "dof", "unit", "samples", "missing_percent", "longest_gap_s", "clipped_percent",
    "constant_percent", "mean", "rms", "least", "largest", "band_low_hz", "band_high_hz", "noise", "noise_is_visible",
    "snr_db",
)  # fmt: skip
# Runs of the same value that are a longer part than this make a channel held, or slower than its file.
FEWEST = 16


def channel_table(signals: Sequence[Signal], sampling: Sampling) -> pd.DataFrame:
    """A row for each channel, columns `COLUMNS`.

    ``rms`` is about the mean. ``noise`` is the standard deviation of the white noise that the channel shows; where
    ``noise_is_visible`` is false, the noise lies below that. ``snr_db`` compares the two.
    """
    return pd.DataFrame([_row(signal, sampling) for signal in signals], columns=list(COLUMNS))


def _row(signal: Signal, sampling: Sampling) -> dict[str, object]:
    there = signal.values[np.isfinite(signal.values)]
    row: dict[str, object] = dict.fromkeys(COLUMNS, np.nan) | {
        "channel": signal.name, "column": signal.column, "quantity": signal.quantity, "dof": signal.place,
        "unit": signal.shown_unit, "samples": len(there),
        "missing_percent": 100.0 * (1.0 - len(there) / len(signal.values)),
        "longest_gap_s": longest_gap(signal.values, sampling),
    }  # fmt: skip
    if len(there) < FEWEST:
        return row
    row |= {
        "clipped_percent": clipped_percent(there), "constant_percent": constant_percent(there),
        "mean": float(there.mean()), "rms": float(there.std()), "least": float(there.min()),
        "largest": float(there.max()),
    }  # fmt: skip
    if np.ptp(there) == 0.0:
        return row
    values, step = sampling.on_regular(signal.values), 1.0 / sampling.rate
    low, high = signal_edges(values, step)
    visible = visible_floor(values, step)
    noise = noise_level(values, step) if visible is None else visible
    power = max(float(np.var(values)) - noise**2, 0.0)
    snr = 10.0 * np.log10(power / noise**2) if noise > 0.0 and power > 0.0 else np.nan
    return row | {
        "band_low_hz": low, "band_high_hz": high, "noise": noise, "noise_is_visible": visible is not None,
        "snr_db": snr,
    }  # fmt: skip


def longest_gap(values: np.ndarray, sampling: Sampling) -> float:
    """The longest time without a sample, s; 0 where every one is there."""
    there = np.flatnonzero(np.isfinite(values))
    if len(there) == 0:
        return sampling.duration
    edges = sampling.time[there]
    longest = float(np.max(np.diff(edges), initial=0.0))
    longest = max(longest, float(edges[0] - sampling.time[0]), float(sampling.time[-1] - edges[-1]))
    return longest if longest > 1.5 * sampling.step else 0.0
