"""The readout weights' part of normal equations, factored; behind one interface, whatever the order of elimination."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from pinn_cli.training.band.diagonals import Diagonals


class ReadoutFactor(ABC):
    """A = R R^T of normal equations [[A, B], [B^T, C]], with the border B of the parameters half solved, R^-1 B.

    R is triangular in an order of the factor's own: what is half solved can be handed back, and added up.
    """

    @property
    @abstractmethod
    def size(self) -> int:
        """Of A."""

    @property
    @abstractmethod
    def operations(self) -> float:
        """Additions and multiplications that the factor, the half solved border and its gram took."""

    @property
    @abstractmethod
    def log_determinant(self) -> float:
        """Logarithm of the determinant of A."""

    @property
    @abstractmethod
    def border_gram(self) -> np.ndarray:
        """B^T A^-1 B, (p, p)."""

    @abstractmethod
    def half_solved(self, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R^-1 right and B^T A^-1 right.

        Args:
            right: (size,) or (size, count).

        Returns:
            (size,) and (p,), or (size, count) and (p, count).
        """

    def last_covariance(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """rows^T A^-1 rows (r, r) and B^T A^-1 rows (p, r) of linear functions of the last weights.

        Args:
            rows: (k, r), by the last k of the weights.
        """
        every = np.zeros((self.size, rows.shape[1]))
        every[self.size - len(rows) :] = rows
        half, taken = self.half_solved(every)
        return half.T @ half, taken

    @abstractmethod
    def solved(self, half: np.ndarray, x: np.ndarray) -> np.ndarray:
        """R^-T (half + R^-1 B x): of half = R^-1 g the solution of A w = g + B x.

        Args:
            half: (size,) or (size, count), half solved.
            x: (p,) or (p, count).
        """

    @property
    def solved_border(self) -> np.ndarray:
        """A^-1 B, (size, p)."""
        p = len(self.border_gram)
        return self.solved(np.zeros((self.size, p)), np.eye(p))

    @abstractmethod
    def inverse(self) -> Diagonals:
        """A^-1, where two weights may be in one row of a residual."""
