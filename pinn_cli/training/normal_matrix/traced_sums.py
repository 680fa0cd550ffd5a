"""The trace of a matrix times a change of sums over rows, asked again and again.

Of rows that are features times coefficients the sums are products of features, which do not change, times products of
coefficients. What of the matrix meets the former is worked out once; the trace is its sum over the latter.
"""

from __future__ import annotations

import numpy as np

from pinn_cli.system.coupling import Coupling
from pinn_cli.training.normal_matrix.elimination import Diagonals
from pinn_cli.training.normal_matrix.row_sums import RowSums
from pinn_cli.training.normal_matrix.separable_rows import LocalFeatures, SeparableRows

# Of rows of one factor: the first feature of a window, and the weights of its groups if these change.
Where = tuple[int, bytes | None]


class Met:
    """A symmetric matrix of the readout weights, and what of it meets the features of one factor's rows.

    It holds every diagonal that rows have.
    """

    def __init__(self, matrix: Diagonals, coupling: Coupling) -> None:
        self._matrix, self._n, self._rank = matrix, coupling.size, coupling.rank
        self._kept: dict[Where, np.ndarray] = {}

    def trace(self, above: TracedSums, below: TracedSums) -> float:
        """Of its product with the difference of two sums."""
        total = self._matrix.trace_of_product(above.band - below.band)
        for where in above.products | below.products:
            change = above.products.get(where, 0.0) - below.products.get(where, 0.0)
            total += float(np.vdot(self._kept[where], change))
        return total

    def meet(self, where: Where, features: LocalFeatures, weight: np.ndarray | None) -> None:
        """Work out what meets products of features, unless it is known.

        (orders squared, n, n), by the earlier feature's function and the later one's; of the lower half, twice.
        """
        if where in self._kept:
            return
        n, total = self._n, np.zeros(())
        lines = dict(zip(self._matrix.offsets.tolist(), self._matrix.values, strict=True))
        for first, by_shift in features.products(weight):
            met = np.zeros((by_shift[0].shape[1], n, n))
            for shift, products in enumerate(by_shift):
                for distance in (d for d in range(1 - n, n) if shift * n + d in lines):
                    offset, at = shift * n + distance, np.arange(max(0, -distance), n - max(0, distance))
                    entries = lines[offset].reshape(-1, n)[first : first + len(products), at]
                    met[:, at, at + distance] += (2.0 if offset else 1.0) * products.T @ entries
            total = total + met
        self._kept[where] = total[:, self._rank[:, None], self._rank]


class TracedSums(RowSums):
    """Sums of which traces of products with a matrix are asked alone; arguments but that as of :class:`RowSums`.

    Attributes:
        products: Of coefficients, of rows that stand in no band.
    """

    def __init__(self, met: Met, *shape: int | Coupling) -> None:
        super().__init__(*shape)  # type: ignore[arg-type]
        self._met, self.products = met, dict[Where, np.ndarray]()

    def add_separable(self, rows: SeparableRows) -> None:
        """See :meth:`RowSums.add_separable`."""
        for weight, products in rows.terms():
            where = rows.features.first, None if weight is None else weight.tobytes()
            self._met.meet(where, rows.features, weight)
            self.products[where] = self.products.get(where, 0.0) + products
