"""What the weighted products of a linear readout's residual rows are summed into."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.training.band.diagonals import Diagonals
from pinn_cli.training.band.equation_rows import EquationRows
from pinn_cli.training.band.subdomains import Subdomains


class RowSums(ABC):
    """Sums over rows [J | P | r] of weighted products, as the parts of a bordered band."""

    @abstractmethod
    def add_rows(
        self,
        segments: Segments,
        rows: EquationRows,
        residual: Tensor,
        weight: Tensor,
        averages: Subdomains | None = None,
    ) -> None:
        """Add rows that touch several DOFs and the parameters.

        Args:
            segments: Of the points, I groups of S.
            rows: The linearised equation of motion there.
            residual: (I, S, n), or (I, 1, n) of averages.
            weight: (n,), or as large as the residual.
            averages: Of the rows, where the residual is averaged.
        """

    @abstractmethod
    def add_own_rows(self, segments: Segments, gram: Tensor, moment: Tensor, weight: Tensor) -> None:
        """Add rows that touch their own DOF.

        Args:
            segments: Their groups.
            gram: (I, B, B) of their features.
            moment: (I, B, n), features against residual.
            weight: (n,).
        """

    @abstractmethod
    def add_pair(self, segments: Segments, products: Tensor, first: int, second: int) -> None:
        """Add products (I, B, B) of the features of two functions; of the second by the first likewise, transposed.

        Args:
            segments: Their groups.
            products: Row: feature of the first function; column: of the second.
            first: One function, counted from 0.
            second: The other; the same for a function's own products.
        """

    @abstractmethod
    def add_moment(self, segments: Segments, moment: Tensor, function: int) -> None:
        """Add features against residual (I, B) of one function to the gradient."""

    @abstractmethod
    def add_border(self, segments: Segments, moment: Tensor, function: int, place: int) -> None:
        """Add features of one function against what a parameter does, (I, B), to that parameter's column."""

    def add_parameters(self, places: Sequence[int], products: Tensor, moments: Tensor) -> None:
        """Add products of parameters among themselves and with the residual.

        Args:
            places: Of p parameters.
            products: (p, p).
            moments: (p,).
        """
        self.corner[np.ix_(places, places)] += products.cpu().numpy()
        self.slope[list(places)] += moments.cpu().numpy()

    @property
    @abstractmethod
    def band(self) -> Diagonals:
        """Of the readout weights against each other, (size, size)."""

    @property
    @abstractmethod
    def gradient(self) -> np.ndarray:
        """(size,), of the readout weights."""

    @property
    @abstractmethod
    def border(self) -> csr_matrix:
        """(size, places), of the readout weights against the parameters."""

    def dense_border(self, pick: np.ndarray) -> np.ndarray:
        """The same as a dense array (size, p), of the parameters at some places (p,)."""
        dense: np.ndarray = self.border[:, pick].toarray()
        return dense

    @property
    @abstractmethod
    def corner(self) -> np.ndarray:
        """(places, places), of the parameters against each other."""

    @property
    @abstractmethod
    def slope(self) -> np.ndarray:
        """(places,), gradient of the parameters."""
