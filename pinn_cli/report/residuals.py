"""What every sensor measured and the estimate does not explain: the content of ``residuals.csv``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.record.channels import channels, clipped_percent, constant_percent
from pinn_cli.record.record import QUANTITIES
from pinn_cli.record.spectrum import band_share, signal_edges
from pinn_cli.report.labels import with_labels
from pinn_cli.report.whiteness import autocorrelation, cumulated_deviation, white_probability
from pinn_cli.verdict.noise_findings import noise_found

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pinn_cli.record.channels import Channel
    from pinn_cli.record.record import Record, Response
    from pinn_cli.training.estimate import Estimate

COLUMNS = (
    "quantity", "dof", "samples", "signal_rms", "residual_rms", "nmse_percent", "sigma", "residual_over_sigma",
    "mean_residual", "whiteness", "largest_autocorrelation", "spectrum_deviation", "band_low_hz", "band_high_hz",
    "band_share_percent", "free_run_nmse_percent", "clipped_percent", "constant_percent",
)  # fmt: skip
LAGS = 20  # of the autocorrelation


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
    rows = [_row(estimate, record, free_run, channel) for channel in channels(record, QUANTITIES)]
    return with_labels(pd.DataFrame(rows, columns=list(COLUMNS)), labels)


def _row(estimate: Estimate, record: Record, free_run: Response | None, channel: Channel) -> dict[str, object]:
    signal, left = channel.measured, channel.measured - channel.of(estimate.response)
    sigma, rms = noise_found(estimate, channel), float(np.sqrt(np.mean(left**2)))
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
        "free_run_nmse_percent": np.nan
        if free_run is None or channel.quantity == "force"
        else nmse_percent(signal - channel.of(free_run), signal),
        "clipped_percent": clipped_percent(signal),
        "constant_percent": constant_percent(signal),
    }
