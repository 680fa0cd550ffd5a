"""How well a channel that the estimator never saw was predicted, in nats per sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pinn_cli.record.channels import Channel, record_band
from pinn_cli.record.record import Record
from pinn_cli.record.spectrum import white_level

# Of the 95 % band of a normal distribution.
NINETY_FIVE_PERCENT = 1.959963984540054
# No sensor is taken to be better than this fraction of its channel's rms: below it, rounding rules.
FINEST_SENSOR = 1e-6


@dataclass(frozen=True)
class Agreement:
    """How a withheld channel was predicted.

    Attributes:
        noise: Standard deviation of the channel's own white noise, in its unit.
        error: Root mean square of prediction minus measurement.
        standardised: Root mean square of the same over its predicted standard deviation, noise included; 1 where the
            spread is right. NaN where the training gives no spread.
        coverage: Share of the measurements within the predicted 95 % band; NaN likewise.
        excess: See :func:`compared`.
    """

    noise: float
    error: float
    standardised: float
    coverage: float
    excess: float


def compared(measured: np.ndarray, mean: np.ndarray, std: np.ndarray, noise: float) -> Agreement:
    """Score a prediction by its excess negative log density over one that knows the response, nats per sample.

    With e the error and v = std^2 + noise^2 the predicted variance of a measurement, the mean of
    1/2 [log(v / noise^2) + e^2 / v - 1]: 0 on average for the true response with no spread, larger for any other normal
    distribution (Gneiting and Raftery 2007, logarithmic score). Where the training gives no spread, v is the mean
    squared error itself, which leaves log(error / noise).

    Args:
        measured: (N,), with its noise.
        mean: (N,), predicted.
        std: (N,), of the response alone; NaN where unknown.
        noise: Of the measurement.
    """
    error = measured - mean
    square = float(np.mean(error**2))
    known = bool(np.isfinite(std).all())
    variance = std**2 + noise**2 if known else np.full_like(error, max(square, noise**2))
    ratio = error**2 / variance
    excess = float(0.5 * np.mean(np.log(variance / noise**2) + ratio - 1.0))
    within = float(np.mean(ratio <= NINETY_FIVE_PERCENT**2))
    return Agreement(
        noise, square**0.5, float(np.mean(ratio)) ** 0.5 if known else np.nan, within if known else np.nan, excess
    )


def channel_noise(record: Record, channel: Channel) -> float:
    """White noise of a channel, read above the record's band or off its repeats: no setting of an estimator is in it.

    Args:
        record: With every sensor.
        channel: One of its own.
    """
    if record.repeats is not None:
        found = float(record.repeats.noise_of_mean(channel.quantity)[channel.dof])
    else:
        found = white_level(channel.measured, record.step, 1.5 * record_band(record))
    return max(found, FINEST_SENSOR * float(np.sqrt(np.mean(channel.measured**2))))
