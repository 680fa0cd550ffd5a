"""The readout weights eliminated one after the other, within their band."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import spmatrix

from pinn_cli.training.band.band_factor import BandFactor
from pinn_cli.training.band.diagonals import Diagonals
from pinn_cli.training.band.readout_factor import ReadoutFactor


@dataclass(frozen=True, eq=False)
class BandElimination(ReadoutFactor):
    """See :class:`ReadoutFactor`; the border is dense once it is half solved.

    Attributes:
        factor: R.
        border: R^-1 B, (size, p).
    """

    factor: BandFactor
    border: np.ndarray

    @classmethod
    def of(cls, band: Diagonals, border: np.ndarray | spmatrix, damping: float = 0.0) -> BandElimination | None:
        """Of a matrix, its scaled diagonal damped, and its border (size, p); None if it is not positive definite."""
        factor = BandFactor.of(band, damping)
        if factor is None:
            return None
        dense = border if isinstance(border, np.ndarray) else border.toarray()
        return cls(factor, factor.forward(dense))

    @property
    def size(self) -> int:
        """See :attr:`ReadoutFactor.size`."""
        return len(self.factor.scale)

    @property
    def operations(self) -> float:
        """See :attr:`ReadoutFactor.operations`."""
        width, size, p = len(self.factor.band) - 1, self.size, self.border.shape[1]
        width = min(width, size - 1)
        factor = (size - width) * (width + 1.0) ** 2 + width * (width + 1.0) * (2 * width + 1) / 6
        below = (size - width) * float(width) + width * (width - 1.0) / 2  # entries of R below its diagonal
        return factor + p * (2.0 * below + size) + float(size) * p**2

    @property
    def log_determinant(self) -> float:
        """See :attr:`ReadoutFactor.log_determinant`."""
        return self.factor.log_determinant

    @property
    def border_gram(self) -> np.ndarray:
        """See :attr:`ReadoutFactor.border_gram`."""
        gram: np.ndarray = self.border.T @ self.border
        return gram

    def half_solved(self, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`ReadoutFactor.half_solved`."""
        half = self.factor.forward(right)
        return half, self.border.T @ half

    def last_covariance(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`ReadoutFactor.last_covariance`: what stands before these weights is not touched."""
        first = self.size - len(rows)
        half = BandFactor(self.factor.band[:, first:], self.factor.scale[first:]).forward(rows)
        return half.T @ half, self.border[first:].T @ half

    def solved(self, half: np.ndarray, x: np.ndarray) -> np.ndarray:
        """See :meth:`ReadoutFactor.solved`."""
        return self.factor.backward(half + self.border @ x)

    @property
    def solved_border(self) -> np.ndarray:
        """See :attr:`ReadoutFactor.solved_border`."""
        return self.factor.backward(self.border)

    def inverse(self) -> Diagonals:
        """See :meth:`ReadoutFactor.inverse`: the whole band of it."""
        return Diagonals.of_band(self.factor.inverse_band())
