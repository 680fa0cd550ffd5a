"""From what acts to every sensor: frequency response and coherence, by Welch's averages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pinn_cli.record.decimation import decimate
from pinn_cli.record.signal import Sampling, Signal
from pinn_cli.record.spectrum import signal_band

# Pieces that a record is cut into, half overlapping: a sixteenth of it, but not below or above so many samples.
PIECES, FEWEST_PIECES, SHORTEST_PIECE, LONGEST_PIECE = 16, 4, 1024, 2**15
# The record keeps this many times the highest frequency of its content.
OVERSAMPLED = 4.0
# Added to a matrix of spectra, of its trace: several forces may be the same.
RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class Spectra:
    """Of all channels, after decimation to the record's band.

    Attributes:
        inputs: What acts; none where nobody measured it.
        outputs: The sensors.
        step: After decimation, s.
        x: (N, inputs), without their means.
        y: (N, outputs), without their means.
        frequency: (F,), Hz.
        power_x: (F, inputs), one-sided density, unit^2/Hz.
        power_y: (F, outputs), the same.
        response: (F, outputs, inputs), complex; the outputs' units per the inputs'.
        coherence: (F, outputs), 0 to 1, with all inputs together; empty (F, 0) without any.
    """

    inputs: Sequence[Signal]
    outputs: Sequence[Signal]
    step: float
    x: np.ndarray
    y: np.ndarray
    frequency: np.ndarray
    power_x: np.ndarray
    power_y: np.ndarray
    response: np.ndarray
    coherence: np.ndarray


def spectra_of(signals: Sequence[Signal], sampling: Sampling, highest: float | None = None) -> Spectra:
    """Of a record's channels, those apart that nobody has said anything of: they count as sensors.

    Args:
        signals: With numbers that vary.
        sampling: Of their values.
        highest: Frequency of any channel's content, Hz; None: it is looked for.
    """
    inputs = [signal for signal in signals if signal.is_input]
    outputs = [signal for signal in signals if not signal.is_input]
    values = np.stack([sampling.on_regular(signal.values) for signal in (*inputs, *outputs)], axis=1)
    values = values - values.mean(axis=0)
    step = 1.0 / sampling.rate
    if highest is None:
        highest = max(signal_band(column, step) for column in values.T)
    factor = max(1, int(1.0 / (step * OVERSAMPLED * highest))) if highest > 0.0 else 1
    values, step = decimate(values, min(factor, max(1, len(values) // 256))), step * factor
    x, y = values[:, : len(inputs)], values[:, len(inputs) :]
    return Spectra(inputs, outputs, step, x, y, *_averaged(x, y, step))


def piece_length(samples: int) -> int:
    """Of a piece of the record, samples."""
    wanted = min(max(samples // PIECES, SHORTEST_PIECE), LONGEST_PIECE)
    return max(16, min(wanted, samples // FEWEST_PIECES))


def chance_coherence(samples: int, probability: float = 0.01) -> float:
    """Coherence that noise alone exceeds at one frequency with this probability.

    Bendat and Piersol, Random Data, 4th edition, section 9.2; pieces that overlap by half count as if they did not.
    """
    pieces = max(2.0 * samples / piece_length(samples) - 1.0, 2.0)
    return float(1.0 - probability ** (1.0 / (pieces - 1.0)))


def _averaged(
    x: np.ndarray, y: np.ndarray, step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Frequency, densities of inputs and outputs, response and coherence; see `Spectra`."""
    p = x.shape[1]
    frequency, every = _cross_spectra(np.concatenate([x, y], axis=1), step)
    power = np.einsum("fii->fi", every).real
    if not p:
        empty = np.zeros((len(frequency), 0))
        return frequency, empty, power, np.zeros((len(frequency), y.shape[1], 0), dtype=complex), empty
    sxx, sxy = every[:, :p, :p], every[:, :p, p:]
    trace = power[:, :p].sum(axis=1) / p
    ridge = RIDGE * np.maximum(trace, np.max(trace) * 1e-12)
    solved = np.linalg.solve(sxx + ridge[:, None, None] * np.eye(p), sxy)
    explained = np.sum(np.conj(sxy) * solved, axis=1).real
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.where(power[:, p:] > 0.0, explained / power[:, p:], 0.0)
    return frequency, power[:, :p], power[:, p:], np.swapaxes(solved, 1, 2), np.clip(coherence, 0.0, 1.0)


def _cross_spectra(values: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, and one-sided cross-spectral densities (F, channels, channels), by Welch's method.

    All pairs from one transform of each piece; `scipy.signal.csd` would make two for each pair.
    """
    from scipy.fft import rfft, rfftfreq

    length = piece_length(len(values))
    window = np.hanning(length + 1)[:-1, None]
    starts = range(0, len(values) - length + 1, length - length // 2)
    total = np.zeros((length // 2 + 1, values.shape[1], values.shape[1]), dtype=complex)
    for start in starts:
        piece = values[start : start + length]
        spectrum = rfft((piece - piece.mean(axis=0)) * window, axis=0)
        total += np.conj(spectrum)[:, :, None] * spectrum[:, None, :]
    sides = np.full(len(total), 2.0)
    sides[0] = 1.0
    if length % 2 == 0:
        sides[-1] = 1.0
    scale = sides * step / (float(np.sum(window**2)) * len(starts))
    return rfftfreq(length, step), total * scale[:, None, None]
