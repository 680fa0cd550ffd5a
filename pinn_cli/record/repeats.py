"""The same experiment measured several times: what is left of it once the repeats are averaged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Repeats:
    """What the mean of several repeats does not say; mean and sum of squares together are sufficient for white noise.

    Attributes:
        count: How often the experiment was measured, R.
        samples: N of each.
        square: Quantity to (n,), the ground's acceleration to (1,), sum over samples and repeats of the squared
            distance from the repeats' mean; NaN where there is no sensor.
    """

    count: int
    samples: int
    square: dict[str, np.ndarray]

    @property
    def freedom(self) -> int:
        """Degrees of freedom of a channel's sum of squares, N (R - 1)."""
        return self.samples * (self.count - 1)

    def noise_of_mean(self, quantity: str) -> np.ndarray:
        """(n,) standard deviation of the white noise that is left on the mean of the repeats, from their scatter."""
        return np.sqrt(self.square[quantity] / self.freedom / self.count)
