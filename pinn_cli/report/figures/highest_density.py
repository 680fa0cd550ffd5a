"""Smoothed densities of draws on a grid, and the smallest regions that hold a share of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

CELLS = 80

# Standard deviation of the kernel at least, cells: one that is narrower than the cells are wide would ring.
NARROWEST = 0.8


def grid_density(
    pairs: np.ndarray, horizontal: tuple[float, float], vertical: tuple[float, float], cells: int = CELLS
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A kernel density of pairs, by smoothing a fine histogram along the principal axes of the draws.

    The kernel is a Gaussian of the draws' own covariance, scaled by Scott's rule (1992) for two dimensions, n^(-1/6),
    so that a narrow ridge between strongly correlated parameters stays narrow.

    Args:
        pairs: (draws, 2).
        horizontal: Limits of the first column.
        vertical: Limits of the second.
        cells: Along each side.

    Returns:
        Centres of the cells (cells,), (cells,), and the share of the draws in each (cells, cells), first column first.
    """
    counts, *edges = np.histogram2d(pairs[:, 0], pairs[:, 1], bins=cells, range=(horizontal, vertical))
    x, y = (0.5 * (edge[1:] + edge[:-1]) for edge in edges)
    steps = np.array([x[1] - x[0], y[1] - y[0]])
    covariance = np.cov(pairs.T) / np.outer(steps, steps) * len(pairs) ** (-1.0 / 3.0) + NARROWEST**2 * np.eye(2)
    # On a grid twice as large, so that what is smoothed out on one side does not come in on the other.
    frequencies = np.stack(np.meshgrid(*[2.0 * np.pi * np.fft.fftfreq(2 * cells)] * 2, indexing="ij"))
    kernel = np.exp(-0.5 * np.einsum("iab,ij,jab->ab", frequencies, covariance, frequencies))
    smooth = np.fft.ifft2(np.fft.fft2(counts, (2 * cells, 2 * cells)) * kernel).real[:cells, :cells]
    return x, y, np.maximum(smooth, 0.0) / max(len(pairs), 1)


def mass_levels(density: np.ndarray, shares: Sequence[float]) -> np.ndarray:
    """The densities above which the given shares of the whole lie.

    Args:
        density: Of any shape, not negative.
        shares: Between 0 and 1.
    """
    ordered = np.sort(density, axis=None)[::-1]
    mass = np.cumsum(ordered)
    reached = np.searchsorted(mass, np.asarray(shares) * mass[-1])
    levels: np.ndarray = ordered[np.minimum(reached, len(ordered) - 1)]
    return levels
