"""Keeping parameters above zero without telling a sampler about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Softplus:
    """theta = w log(1 + exp(x / w)), of several parameters at once: an exponential below w, a straight line above it.

    With w the width of the posterior of theta, a parameter that the record determines keeps its Gaussian likelihood
    and its linear correlations, and one that may be zero is spread over the logarithmic part. An exponential
    throughout bends both: of six parameters with relative standard deviations of 30 % and correlations of 0.99, NUTS
    then lost 5 % of its iterations to divergences.

    Attributes:
        width: (g,), w, in the parameters' units.
    """

    width: np.ndarray

    def parameters(self, x: np.ndarray) -> np.ndarray:
        """Theta (..., g) > 0 of x (..., g)."""
        return self.width * np.logaddexp(0.0, x / self.width)

    def coordinates(self, theta: np.ndarray) -> np.ndarray:
        """X (..., g) of theta (..., g) > 0."""
        return theta + self.width * np.log(-np.expm1(-theta / self.width))

    def slopes(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of theta (g,): d theta/dx, its logarithm, and the derivative of that by x."""
        decay = np.exp(-theta / self.width)
        by_x = -np.expm1(-theta / self.width)
        return by_x, np.log(by_x), decay / self.width
