"""What a band-limited history does between its samples, and how well the samples tell it.

Best linear interpolation (kriging; Rasmussen and Williams 2006, section 2.2) of a process whose power is spread evenly
over a band, from the nearest samples. In the middle of a record that is a windowed sinc series, and exact for all
practical purposes; at its ends, where half of the neighbours are missing, the standard deviation says what is lost.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from pinn_cli.record.spectrum import noise_level

# Neighbours on either side. A sine at 90 % of the Nyquist frequency is told to 2e-5 of its size with 64 of them, at
# 95 % to 2e-4; fewer are too few for what the band leaves to interpolate with.
REACH = 64
# Least power of a sample that is its own noise, over that of the process: keeps the weights from exploding.
LEAST_NOISE = 1e-7
# Noise over the rms of a history that its interpolation allows for at most: more would smooth the history.
NOISIEST = 0.1
# The process fills the spectrum up to this part of the sampling rate, whatever the history's own band: the noise
# between the samples is then that of the samples. Closer to one half nothing is left to interpolate with.
BAND = 0.475


def refined_times(time: np.ndarray, refinement: int) -> np.ndarray:
    """Times (N,) with ``refinement`` - 1 more between any two: ((N - 1) refinement + 1,)."""
    if refinement == 1:
        return time
    last = len(time) - 1
    return np.interp(np.arange(last * refinement + 1) / refinement, np.arange(last + 1), time)


def refined_history(values: np.ndarray, refinement: int, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Histories at :func:`refined_times`, and the standard deviation of what the samples leave open there.

    Args:
        values: (N, n), samples; they come out unchanged.
        refinement: Intervals that each step is divided into.
        noise: White noise of the samples over their rms. What it costs in the middle of a record is that of the samples
            themselves, and does not count.

    Returns:
        (N', n) values, and (N',) standard deviations over the rms of the history, 0 at the samples.
    """
    samples = len(values)
    out = np.empty(((samples - 1) * refinement + 1, values.shape[1]))
    spread = np.zeros(len(out))
    out[::refinement] = values
    if refinement == 1:
        return out, spread
    width = min(2 * REACH, samples)
    reach = width // 2
    nugget = max(noise**2, LEAST_NOISE)
    correlation = _correlation(BAND)
    neighbours, factor = _neighbours(width, nugget)
    # What is most probable of a noisy history is smaller than it. Here it keeps the size of the samples: else inputs
    # would be too small, by a per cent at 20 dB.
    whole = 1.0 + 2.0 * BAND * nugget
    for part in range(1, refinement):
        inside = np.arange(samples - 1)
        first = np.clip(inside - reach + 1, 0, samples - width)
        for place in np.unique(inside - first):
            here = inside[inside - first == place]
            known = correlation(place + part / refinement - neighbours)
            weights = cho_solve(factor, known)
            windows = first[inside - first == place][:, None] + np.arange(width)
            out[here * refinement + part] = np.einsum("k,ikn->in", whole * weights, values[windows])
            spread[here * refinement + part] = 1.0 - weights @ known
        # In the middle of a long record next to nothing is left open but the samples' own noise.
        parts = spread[part::refinement]
        parts[:] = np.sqrt(np.maximum(parts - _in_the_middle(part / refinement, nugget), 0.0))
    return out, spread


def interpolated(values: np.ndarray, step: float, refinement: int) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Histories at :func:`refined_times` as the noise that their spectra show allows.

    Args:
        values: (N, n), samples.
        step: From sample to sample, s.
        refinement: Intervals that each step is divided into.

    Returns:
        Both of :func:`refined_history`, and the noise of every history that is not zero over its rms.
    """
    rms = np.sqrt(np.mean(values**2, axis=0))
    noise = [noise_level(column, step) / level for column, level in zip(values.T, rms, strict=True) if level > 0.0]
    return *refined_history(values, refinement, min(max(noise, default=0.0), NOISIEST)), noise


def _neighbours(width: int, nugget: float) -> tuple[np.ndarray, tuple[np.ndarray, bool]]:
    """Places of the samples that one value is told from, and the Cholesky factor of their covariance."""
    places = np.arange(width, dtype=float)
    return places, cho_factor(_correlation(BAND)(places[:, None] - places) + nugget * np.eye(width))


def _in_the_middle(part: float, nugget: float) -> float:
    """Variance that is left open with `REACH` neighbours on either side, at a part of a step."""
    places, factor = _neighbours(2 * REACH, nugget)
    known = _correlation(BAND)(REACH - 1 + part - places)
    return float(1.0 - known @ cho_solve(factor, known))


def _correlation(band: float) -> Callable[[np.ndarray], np.ndarray]:
    """Of a process with an even spectrum up to ``band``, in cycles per sample, by lag in samples."""
    return lambda lag: np.sinc(2.0 * band * lag)
