"""Pairs of DOFs whose drift a user wants to know beside those of the connections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_matrix


@dataclass(frozen=True, eq=False)
class Pairs:
    """Nothing joins them: they have a drift, and no force.

    Attributes:
        names: Of the pairs.
        weights: (P, dofs), of the displacements in each drift.
    """

    names: tuple[str, ...] = ()
    weights: csr_matrix = field(default_factory=lambda: csr_matrix((0, 0)))

    @classmethod
    def of(cls, names: Sequence[str], weights: Sequence[Mapping[int, float]], dofs: int) -> Pairs:
        """Of a map of DOF, counted from 0, to weight for every pair."""
        matrix = np.zeros((len(names), dofs))
        for row, own in zip(matrix, weights, strict=True):
            row[list(own)] = list(own.values())
        return cls(tuple(names), csr_matrix(matrix))
