"""What every sensor measured and the estimate does not explain: the content of ``residuals.csv``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from pinn_cli.record.record import QUANTITIES, RESPONSE_QUANTITIES
from pinn_cli.record.spectrum import band_share, signal_edges
from pinn_cli.report.labels import with_labels
from pinn_cli.report.whiteness import LAGS, autocorrelation, cumulated_deviation, white_probability

if TYPE_CHECKING:
    from pinn_cli.record.record import Record, Response
    from pinn_cli.training.estimate import Estimate

COLUMNS = (
    "quantity", "dof", "samples", "signal_rms", "residual_rms", "nmse_percent", "sigma", "residual_over_sigma",
    "mean_residual", "whiteness", "largest_autocorrelation", "spectrum_deviation", "band_low_hz", "band_high_hz",
    "band_share_percent", "free_run_nmse_percent", "clipped_percent", "constant_percent",
)  # fmt: skip

# Equal samples in a row that noise and a converter's steps do not explain; and samples at an extreme value that may be
# there by chance.
CONSTANT_RUN, AT_EXTREME_BY_CHANCE = 8, 2


class Channel(NamedTuple):
    """A sensor.

    Attributes:
        quantity: One of `pinn_cli.record.record.QUANTITIES`.
        dof: Counted from 0.
    """

    quantity: str
    dof: int


def channels(record: Record) -> list[Channel]:
    """Every response sensor and every force sensor, quantity by quantity; a force known to be zero is none."""
    return [Channel(q, int(dof)) for q in QUANTITIES for dof in np.flatnonzero(record.sensors(q))]


def measured(record: Record, channel: Channel) -> np.ndarray:
    """(N,), as the sensor gave it, in the unit of its quantity."""
    values: np.ndarray = getattr(record, channel.quantity)[:, channel.dof]
    return values


def residual(response: Response, record: Record, channel: Channel) -> np.ndarray:
    """(N,), measured less estimated, in the unit of the channel's quantity."""
    values: np.ndarray = measured(record, channel) - getattr(response, channel.quantity)[:, channel.dof]
    return values


def noise_found(summary: Mapping[str, Any], channel: Channel) -> float:
    """The standard deviation of the channel's noise that a training found, in its unit; NaN where it gives none.

    Args:
        summary: Of an `Estimate`: ``sigma_acceleration`` and so on, a value or None for every DOF.
        channel: The sensor.
    """
    levels = summary.get(f"sigma_{channel.quantity}")
    if not isinstance(levels, list | tuple | np.ndarray) or levels[channel.dof] is None:
        return np.nan
    return float(levels[channel.dof])


def nmse_percent(left: np.ndarray, signal: np.ndarray) -> float:
    """100 mean(r^2) / variance of the signal: 0 is perfect, 100 predicts nothing; NaN of a constant signal.

    Args:
        left: r (N,), what is left of it.
        signal: (N,).
    """
    variance = float(np.var(signal))
    return 100.0 * float(np.mean(left**2)) / variance if variance > 0.0 else np.nan


def residual_table(
    estimate: Estimate, record: Record, free_run: Response | None, labels: Mapping[str, object]
) -> pd.DataFrame:
    """One row per sensor.

    Args:
        estimate: Its response is compared with the sensors; its ``summary`` has the noise found.
        record: The sensors.
        free_run: Of the estimated system under the measured force, (N, n) each; None where there is none.
        labels: A value for each of `pinn_cli.report.labels.LABELS`.

    Returns:
        Columns: the labels and `COLUMNS`. In the unit of the quantity: ``signal_rms`` (about the mean),
        ``residual_rms`` and ``mean_residual`` of r = measured - estimated, ``sigma`` (noise found). In per cent:
        ``nmse_percent`` (see `nmse_percent`), ``free_run_nmse_percent`` (the same of the free run; the force has none,
        being given), ``band_share_percent`` (of the signal's power, between ``band_low_hz`` and ``band_high_hz``, where
        the signal stands out of its noise), ``clipped_percent`` and ``constant_percent`` (see there). Of r about its
        mean: ``whiteness`` (the probability that white noise would look less white; near 0, r is not white),
        ``spectrum_deviation`` (the distance that this judges), ``largest_autocorrelation`` (with its sign, within
        `LAGS` lags; white noise stays within about 3 / sqrt(samples)). What is not known is empty (NaN).
    """
    rows = [_row(estimate, record, free_run, channel) for channel in channels(record)]
    return with_labels(pd.DataFrame(rows, columns=list(COLUMNS)), labels)


def _row(estimate: Estimate, record: Record, free_run: Response | None, channel: Channel) -> dict[str, object]:
    signal, left = measured(record, channel), residual(estimate.response, record, channel)
    sigma, rms = noise_found(estimate.summary, channel), float(np.sqrt(np.mean(left**2)))
    correlation = autocorrelation(left, LAGS)
    low, high = signal_edges(signal, record.step)
    return {
        "quantity": channel.quantity,
        "dof": channel.dof + 1,
        "samples": len(signal),
        "signal_rms": float(np.std(signal)),
        "residual_rms": rms,
        "nmse_percent": nmse_percent(left, signal),
        "sigma": sigma,
        "residual_over_sigma": rms / sigma if sigma > 0.0 else np.nan,
        "mean_residual": float(np.mean(left)),
        "whiteness": white_probability(left),
        "largest_autocorrelation": float(max(correlation, key=abs)),
        "spectrum_deviation": cumulated_deviation(left),
        "band_low_hz": low,
        "band_high_hz": high,
        "band_share_percent": 100.0 * band_share(signal, record.step, low, high),
        "free_run_nmse_percent": _free_run_nmse(free_run, record, channel),
        "clipped_percent": clipped_percent(signal),
        "constant_percent": constant_percent(signal),
    }


def _free_run_nmse(free_run: Response | None, record: Record, channel: Channel) -> float:
    if free_run is None or channel.quantity not in RESPONSE_QUANTITIES:
        return np.nan
    return nmse_percent(residual(free_run, record, channel), measured(record, channel))


def clipped_percent(signal: np.ndarray) -> float:
    """Share of samples (N,) that sit at the channel's own largest or least value, %; 0 of one or two.

    A value that is the median is none that the channel was clipped at: a hammer's force rests at its least value.
    """
    clipped, rest = 0, np.median(signal)
    for extreme in {float(signal.max()), float(signal.min())}:
        count = int(np.sum(signal == extreme))
        clipped += count if count > AT_EXTREME_BY_CHANCE and extreme != rest else 0
    return 100.0 * clipped / len(signal)


def constant_percent(signal: np.ndarray) -> float:
    """Share of samples (N,) in runs of `CONSTANT_RUN` or more equal values, zeros included, %."""
    ends = np.flatnonzero(np.diff(signal)) + 1
    lengths = np.diff(np.concatenate(([0], ends, [len(signal)])))
    return 100.0 * float(lengths[lengths >= CONSTANT_RUN].sum()) / len(signal)
