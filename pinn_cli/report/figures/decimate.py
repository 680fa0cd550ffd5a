"""Fewer points than samples: what a line needs to look the same at the resolution of a printed page."""

from __future__ import annotations

import numpy as np


def line_indices(values: np.ndarray, points: int = 1500) -> np.ndarray:
    """Indices of at most ``points`` samples of a line that keep its outline: the lowest and highest of each bin.

    Args:
        values: (time,), without NaN.
        points: How many to keep at most; records shorter than that are kept whole.

    Returns:
        Increasing indices into ``values``.
    """
    samples = len(values)
    if samples <= points:
        return np.arange(samples)
    bins = max((points - 2) // 2, 1)
    width = -(-samples // bins)
    padded = np.pad(values, (0, bins * width - samples), mode="edge").reshape(bins, width)
    start = np.arange(bins) * width
    extremes = np.concatenate([start + padded.argmin(axis=1), start + padded.argmax(axis=1), [0, samples - 1]])
    return np.unique(np.minimum(extremes, samples - 1))


def block_maximum(values: np.ndarray, columns: int = 400) -> np.ndarray:
    """The largest value in each of at most ``columns`` stretches of time, so that no peak of an error is lost.

    Args:
        values: (time, dof); NaN where unknown.
        columns: How many stretches at most.

    Returns:
        (columns, dof), or ``values`` if it is no longer than that; NaN where a whole stretch is unknown.
    """
    samples = len(values)
    if samples <= columns:
        return values
    edges = np.linspace(0, samples, columns + 1).astype(int)[:-1]
    return np.fmax.reduceat(values, edges, axis=0)
