"""The channels of a record: their band, how large the motion is, what a sensor has not followed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from pinn_cli.record.channel import Channel
from pinn_cli.record.record import Record
from pinn_cli.record.response import MEASURED_QUANTITIES, QUANTITIES, RESPONSE_QUANTITIES
from pinn_cli.record.spectrum import LOWEST_BINS, USABLE_NYQUIST_FRACTION, periodogram, signal_band, visible_floor
from pinn_cli.system.quantities import GROUND, SUPPORT

# Part of a channel's spread, or of whatever else is estimated, to which it is known at best: below it rounding and the
# splines' own error rule.
FINEST_KNOWN = 1e-6
# Equal samples in a row that noise and a converter's steps do not explain; and samples at an extreme value that may be
# there by chance.
CONSTANT_RUN, AT_EXTREME_BY_CHANCE = 8, 2
# A run of equal samples is a dropout if the signal moves on average by this share of its rms in that time, and some
# other one has this share of its rms meanwhile: else the structure may be at rest. Levels of a converter so far apart,
# over the rms, are too coarse to tell.
DROPOUT_MOTION, OTHERS_MOVE, COARSE = 0.5, 0.2, 0.1
# Records whose band is kept: a run asks for that of the same few some hundred times.
RECENT = 4
# Of the mains, Hz. A sine of such a frequency has one phase in all parts of a record, which a mode has by chance alone:
# the statistic of so many parts is F-distributed, and beyond `STEADY_LINE` once in 10^7 times. It is told from such a
# part of the channel's power on; and what acts has a line of its own from `FAINT` on.
MAINS, LINE_PARTS, STEADY_LINE, FAINT, LEAST_HUM = (50.0, 60.0), 8, 50.0, 10.0, 0.05


def channels(
    record: Record, quantities: Sequence[str] = RESPONSE_QUANTITIES, excused: Sequence[str] = ()
) -> list[Channel]:
    """Columns of a record, quantity by quantity, the ground's last; a force that is known to be zero is none."""
    asked = [quantity for quantity in quantities if quantity in QUANTITIES]
    asked += [quantity for quantity in record.supports if quantity in quantities]
    asked += [GROUND] if GROUND in quantities and record.measured_ground is not None else []
    columns = [
        record.column(quantity, i) for quantity in asked for i in np.flatnonzero(record.sensors(quantity)).tolist()
    ]
    return [channel for channel in columns if channel.name not in excused]


def every_channel(record: Record, quantities: Sequence[str] = MEASURED_QUANTITIES) -> list[Channel]:
    """The same, and behind them sensors that have no column: of sums, of connections, a second one of a kind."""
    return channels(record, quantities) + [
        channel for channel in record.corrected if not channel.is_column and np.isfinite(channel.measured).all()
    ]


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
    return 100.0 * sum(end - begin for begin, end in equal_runs(signal)) / len(signal)


def equal_runs(signal: np.ndarray) -> list[tuple[int, int]]:
    """First and last index + 1 of every run of `CONSTANT_RUN` equal samples (N,) or more."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(signal)) + 1, [len(signal)]])
    long = np.flatnonzero(np.diff(edges) >= CONSTANT_RUN)
    return list(zip(edges[long].tolist(), edges[long + 1].tolist(), strict=True))


def dropouts(signal: np.ndarray, others: Sequence[np.ndarray]) -> list[tuple[int, int]]:
    """The same of the runs in which a signal (N,) rests for longer than it takes to move, while one of others moves."""
    if np.min(np.diff(np.unique(signal)), initial=np.inf) > COARSE * np.std(signal):  # it rests on each level
        return []
    return [
        (begin, end) for begin, end in equal_runs(signal)
        if _moves_within(signal, end - begin) and any(np.std(x[begin:end]) > OTHERS_MOVE * np.std(x) for x in others)
    ]  # fmt: skip


def _moves_within(signal: np.ndarray, samples: int) -> bool:
    """Whether a signal moves, over so many samples, by a good part of its rms."""
    lag = max(1, min(samples // 2, len(signal) // 2))
    return bool(np.sqrt(np.mean((signal[lag:] - signal[:-lag]) ** 2)) > DROPOUT_MOTION * np.std(signal))


def hum(signal: np.ndarray, step: float, acting: Sequence[np.ndarray]) -> tuple[float, float] | None:
    """Frequency of the mains, Hz, of which a signal (N,) has a line, and the line's share of its power.

    None where it has none, or where something that acts (N,) has it too: then it may be a machine.
    """
    steadiness, share, line = max((*_steadiness(signal, frequency * step), frequency) for frequency in MAINS)
    if not (steadiness > STEADY_LINE and share > LEAST_HUM):
        return None
    acts = any(_steadiness(other, line * step)[0] > FAINT for other in acting)
    return None if acts else (line, share)


def of_mains(line: float, step: float) -> str:
    """``50 Hz of the mains``, and where the samples show it if they are too few; it may be a line there."""
    shown = abs(line - round(line * step) / step)
    return f"{line:g} Hz of the mains" + (f", or at {shown:.4g} Hz, where its samples show it" if shown < line else "")


def _steadiness(signal: np.ndarray, turns: float) -> tuple[float, float]:
    """How steady a line is, as F with 2 and 2 (`LINE_PARTS` - 1) degrees of freedom, and its share of the power.

    It turns so often from sample to sample; beyond one half it shows where the samples of the signal (N,) put it.
    """
    turns, length = abs(turns - round(turns)), len(signal) // LINE_PARTS
    if min(turns, 0.5 - turns) * length < 2.0:  # no line of its own
        return 0.0, 0.0
    window = np.hanning(length + 2)[1:-1]
    turning = np.exp(-2j * np.pi * turns * np.arange(LINE_PARTS * length))
    turned = (signal - signal.mean())[: LINE_PARTS * length] * turning
    parts = turned.reshape(LINE_PARTS, length) @ (window / window.sum())
    line, variance = abs(parts.mean()) ** 2, float(np.sum(np.abs(parts - parts.mean()) ** 2)) / (LINE_PARTS - 1)
    return LINE_PARTS * line / max(variance, 1e-300), 2.0 * line / max(float(np.var(signal)), 1e-300)


@lru_cache(maxsize=RECENT)
def record_band(record: Record) -> float:
    """The widest band of any measured channel of the record, Hz; at least the record's own frequency resolution.

    The motion of the ground, or of a support, is followed as far as it may reach: where it shows no noise above its
    content, that is all that can be used.
    """
    columns, usable = channels(record, MEASURED_QUANTITIES), USABLE_NYQUIST_FRACTION * 0.5 / record.step
    bands = [signal_band(channel.measured, record.step) for channel in columns]
    moved = [channel.measured for channel in columns if channel.quantity not in QUANTITIES]
    bands += [usable for history in moved if visible_floor(history, record.step) is None]
    return max(*bands, 1.0 / record.duration)


def motion_amplitudes(record: Record) -> dict[str, float]:
    """Root mean square of displacement (m), velocity (m/s) and acceleration (m/s^2) where the record moves most.

    A quantity without a sensor comes from the measured one that is fewest derivatives away, integrated or
    differentiated in the frequency domain over the record's band. Hidden DOFs may move more: only orders of magnitude
    matter to those who scale their numbers by it. It is 1 where the channel that it comes from shows nothing at all.
    """
    columns, band, amplitudes = channels(record), record_band(record), {}
    for order, quantity in enumerate(RESPONSE_QUANTITIES):
        source = min((channel.order for channel in columns), key=lambda given, order=order: abs(given - order))  # type: ignore[misc]
        nearest = [channel.measured for channel in columns if channel.order == source]
        amplitudes[quantity] = max(_rms(history, record.step, band, order - source) for history in nearest) or 1.0
    return amplitudes


def slowest_motion(record: Record) -> float:
    """Least ratio of rms acceleration to rms displacement over the measured channels, 1/s^2.

    Motion far from a force is slower than near it, so of what was measured the slowest channel comes nearest to what
    was not.
    """
    band, ratios = record_band(record), []
    for channel in channels(record):
        displacement, acceleration = (_rms(channel.measured, record.step, band, q - channel.order) for q in (0, 2))
        if displacement > 0:
            ratios.append(acceleration / displacement)
    return min(ratios, default=(math.pi * band) ** 2)


def support_amplitudes(record: Record) -> np.ndarray:
    """(S,), root mean square of the displacement of every support, m."""
    band, out = record_band(record), np.zeros(len(record.support_names))
    for channel in reversed(channels(record, tuple(SUPPORT))):
        history = channel.measured - channel.measured.mean()
        out[channel.dof] = _rms(history, record.step, band, -channel.order)
    return out


def _rms(channel: np.ndarray, step: float, band: float, derivatives: int) -> float:
    """Root mean square of a channel (N,) after so many time derivatives; negative ones are integrals."""
    if derivatives == 0:
        return float(np.sqrt(np.mean(channel**2)))
    frequency, power = periodogram(channel, step)
    kept = slice(LOWEST_BINS, max(LOWEST_BINS + 1, int(np.searchsorted(frequency, band, side="right"))))
    gain = (2.0 * np.pi * frequency[kept]) ** (2 * derivatives)
    return float(np.sqrt(2.0 * np.sum(gain * power[kept]) / len(channel)))
