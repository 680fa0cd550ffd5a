"""Which coordinates stretch which connection: the incidence matrix B of a structure; and pairs that nothing joins."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from scipy.sparse import csr_matrix, diags

from pinn_cli.system.array_namespace import Array

# Up to here a product with the dense matrix, exact for weights of one, takes a quarter of the time of a look-up; a
# simulation asks for it ten thousand times. Beyond it a look-up is faster unless most entries are weights.
_SHORT, _FULL = 64, 0.5


class Incidence:
    """B, (connections, coordinates): the elongations of connections are e = B q, their pull on the coordinates B' r.

    Args:
        matrix: Sparse; a row holds the weights of the coordinates that stretch its connection.

    Attributes:
        matrix: B.
        shape: Connections C and coordinates n.
    """

    def __init__(self, matrix: csr_matrix) -> None:
        self.matrix = csr_matrix(matrix, dtype=np.float64)
        self.shape: tuple[int, int] = self.matrix.shape
        self._short = max(self.shape) <= _SHORT or self.matrix.nnz > _FULL * self.shape[0] * self.shape[1]
        # Slices are faster than products of tensors, and a training asks for nothing else.
        self._is_chain = self.shape[0] == self.shape[1] and (self.matrix != _chain(self.shape[0])).nnz == 0
        self._dense: dict[Any, Any] = {}
        self._tables: dict[Any, Any] = {}

    @classmethod
    def chain(cls, ndof: int) -> Incidence:
        """Of masses in a row: connection i joins coordinate i - 1 to i, the first one the ground to the first."""
        return cls(_chain(ndof))

    @classmethod
    def between(cls, ends: Iterable[Mapping[int, float]], ndof: int) -> Incidence:
        """Of connections given by the weights of their coordinates, counted from 0; the ground is left out.

        Raises:
            ValueError: A coordinate that there is not, or a connection without any.
        """
        rows = list(ends)
        for row in rows:
            if not row or not all(0 <= dof < ndof for dof in row):
                raise ValueError(f"a connection has weights of coordinates 0 to {ndof - 1}, not {dict(row)}")
        places = [(i, dof, weight) for i, row in enumerate(rows) for dof, weight in row.items()]
        i, dof, weight = zip(*places, strict=True)
        return cls(csr_matrix((weight, (i, dof)), shape=(len(rows), ndof)))

    def elongation(self, x: Array) -> Array:
        """B x: (..., n) to (..., C), of displacements, velocities or accelerations alike."""
        return self._product(x, transposed=False)

    def pull(self, r: Array) -> Array:
        """B' r: (..., C) to (..., n), what the connections' forces pull the coordinates back with."""
        return self._product(r, transposed=True)

    def products(self) -> tuple[np.ndarray, np.ndarray] | None:
        """B' and B (float64), which states and forces are multiplied by from the right; None where sums are quicker."""
        like = np.empty(0)
        return (self._like(like, transposed=False), self._like(like, transposed=True)) if self._short else None

    def _product(self, x: Array, transposed: bool) -> Array:
        if self._is_chain and isinstance(x, torch.Tensor):
            before, after = x[..., :-1], x[..., 1:]
            return torch.cat((before - after, x[..., -1:]) if transposed else (x[..., :1], after - before), -1)
        if self._short:
            by = self._like(x, transposed)
            return x.dot(by) if isinstance(x, np.ndarray) else x @ by
        places, weights = self._table(x, transposed)
        terms = [x[..., place] * weight for place, weight in zip(places, weights, strict=True)]
        return sum(terms[1:], start=terms[0])

    def _like(self, x: Array, transposed: bool) -> Any:
        """B' or, transposed, B itself, dense, for products from the right; as x is."""
        key = (transposed, x.dtype, getattr(x, "device", None))
        if key not in self._dense:
            dense = self.matrix.toarray()
            dense = dense if transposed else np.ascontiguousarray(dense.T)
            self._dense[key] = _as(x, dense)
        return self._dense[key]

    def _table(self, x: Array, transposed: bool) -> Any:
        """For every output its inputs and their weights, padded with weights of 0; a list entry per input."""
        key = (transposed, x.dtype, getattr(x, "device", None))
        if key not in self._tables:
            places, weights = padded(self.matrix.T.tocsr() if transposed else self.matrix)
            device = getattr(x, "device", None)
            columns = places.T if isinstance(x, np.ndarray) else torch.as_tensor(places.T, device=device)
            self._tables[key] = list(columns), list(_as(x, weights.T))
        return self._tables[key]

    @cached_property
    def touching(self) -> np.ndarray:
        """(n, F), the connections that pull at each coordinate, ascending; at the end C, which is none."""
        places, weights = padded(self.matrix.T.tocsr())
        return np.where(weights == 0, self.shape[0], places)

    @cached_property
    def sign(self) -> np.ndarray:
        """(n, F), their weights there, B'; 0 where there is none."""
        return padded(self.matrix.T.tocsr())[1]


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of DOFs whose drift a user wants to know: nothing joins them, they have no force.

    Attributes:
        names: Of the pairs.
        weights: (P, dofs), of the displacements in each drift.
    """

    names: tuple[str, ...]
    weights: csr_matrix

    @classmethod
    def of(cls, names: Sequence[str], weights: Sequence[Mapping[int, float]], dofs: int) -> Pairs:
        """Of a map of DOF, counted from 0, to weight for every pair."""
        matrix = np.zeros((len(names), dofs))
        for row, weight_of in zip(matrix, weights, strict=True):
            row[list(weight_of)] = list(weight_of.values())
        return cls(tuple(names), csr_matrix(matrix))


def _as(x: Any, values: np.ndarray) -> Any:
    """Values as x is: an array of its dtype, or a tensor of its dtype and device."""
    return values.astype(x.dtype) if isinstance(x, np.ndarray) else torch.as_tensor(values).to(x)


def _chain(ndof: int) -> csr_matrix:
    return diags([np.ones(ndof), -np.ones(max(0, ndof - 1))], [0, -1], shape=(ndof, ndof), format="csr")


def padded(matrix: csr_matrix) -> tuple[np.ndarray, np.ndarray]:
    """Columns (rows, most) and values of every row of a sparse matrix, ascending, padded with zeros."""
    matrix.sort_indices()
    count = np.diff(matrix.indptr)
    places = np.zeros((len(count), max(1, int(count.max(initial=0)))), dtype=np.int64)
    values = np.zeros(places.shape)
    inside = np.arange(places.shape[1]) < count[:, None]
    places[inside], values[inside] = matrix.indices, matrix.data
    return places, values
