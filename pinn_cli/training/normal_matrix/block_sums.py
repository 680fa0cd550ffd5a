"""Normal equations of rows that touch most functions, by products of matrices.

The block of features f and f + s is a sum over the groups of times that both are alive in. Every row of a group stands
under each of its features, so that of a feature all rows of all its groups stand below one another: the block is one
product of two such matrices.
"""

from __future__ import annotations

import numpy as np


class BlockSums:
    """Sums over rows of weighted products, of all functions with each other and with the parameters.

    Args:
        features: B, alive at once.
        count: Of one function in all.
        functions: n.
        places: p, of parameters.

    Attributes:
        border: (count, n, p + 1), of the weights against the parameters, at last against the residuals.
        reached: (n, p) bool, which parameters stand in a row of which function.
    """

    def __init__(self, features: int, count: int, functions: int, places: int) -> None:
        # By feature and function, those that follow: of the feature itself first, then of the later ones.
        self._later = np.zeros((count, functions, (features + 1) * functions))
        self.border = np.zeros((count, functions, places + 1))
        self.reached = np.zeros((functions, places), dtype=bool)

    def add(self, first: int, stride: int, rows: np.ndarray, by: np.ndarray) -> None:
        """Add the products of rows with themselves.

        Args:
            first: Feature of the first group; each group begins ``stride`` further on.
            stride: See above.
            rows: (I, R, B, n), of I groups, R each, by the weights.
            by: (I, R, p + 1), by the parameters, and the residuals.
        """
        if len(rows) < rows.shape[2]:
            for group, (group_rows, group_by) in enumerate(zip(rows, by, strict=True)):
                self._add_group(first + group * stride, group_rows, group_by)
            return
        groups, per_group, features, functions = rows.shape
        last = (groups - 1) * stride + 1
        count = last - 1 + features
        below, border = (np.zeros((count, features, per_group, width)) for width in (functions, by.shape[2]))
        for b in range(features):
            below[b : b + last : stride, b], border[b : b + last : stride, b] = rows[:, :, b], by
        below, border = (x.reshape(count, features * per_group, -1) for x in (below, border))
        across = below.swapaxes(1, 2)
        self.border[first : first + count] += across @ border
        for shift in range(features):
            # Rows under both: of the earlier feature all but the last groups, of the later one all but the first.
            shared = (features - shift) * per_group
            products = across[: count - shift, :, :shared] @ below[shift:, shift * per_group :]
            self._block(shift)[first : first + count - shift] += products

    def add_products(self, first: int, shift: int, products: np.ndarray) -> None:
        """Add (F, n, n), of the functions of the first and following features with those of later ones."""
        self._block(shift)[first : first + len(products)] += products

    def _add_group(self, first: int, rows: np.ndarray, by: np.ndarray) -> None:
        """Of one group (R, B, n) by itself."""
        features, functions = rows.shape[1:]
        flat = rows.reshape(len(rows), -1)
        self.border[first : first + features] += (flat.T @ by).reshape(features, functions, -1)
        products = (flat.T @ flat).reshape(features, functions, features, functions)
        for shift in range(features):
            earlier = np.arange(features - shift)
            self._block(shift)[first : first + features - shift] += products[earlier, :, earlier + shift]

    def _block(self, shift: int) -> np.ndarray:
        """(count, n, n), of every feature's functions with those of a later one."""
        functions = self._later.shape[1]
        return self._later[:, :, shift * functions : (shift + 1) * functions]

    def line(self, offset: int) -> np.ndarray:
        """(count n,), a diagonal of the lower half by its columns: so far below the main one."""
        by_feature, by_function, entry = self._later.strides
        start = self._later[:, :, offset:]
        shape, strides = self._later.shape[:2], (by_feature, by_function + entry)
        return np.lib.stride_tricks.as_strided(start, shape, strides, writeable=False).reshape(-1)
