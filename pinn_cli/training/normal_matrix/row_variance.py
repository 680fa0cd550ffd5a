"""Variances of many linear rows that all take weights at the same distances from a first one, line by line.

The covariance of two weights at a fixed distance is one line of the inverse. So the rows of all groups are multiplied
entry by entry with pieces of lines, and no group's own covariance is made.
"""

from __future__ import annotations

import numpy as np

from pinn_cli.training.normal_matrix.diagonals import Diagonals

# Groups from which on lines are quicker than a covariance for each.
ENOUGH = 1000


def is_alike(position: np.ndarray) -> bool:
    """Whether there are many groups, and the weights (I, C) of each are at the same distances from its first one."""
    return len(position) >= ENOUGH and bool((position - position[:, :1] == position[0] - position[0, 0]).all())


def row_variance(
    inverse: Diagonals, carried: np.ndarray, position: np.ndarray, rows: np.ndarray, given: np.ndarray | None = None
) -> np.ndarray:
    """Variance of linear rows, (I, S).

    Args:
        inverse: Covariance of the weights with the parameters held.
        carried: (p, size), how the weights follow p independent unit parameters.
        position: (I, C), of the weights, see :func:`is_alike`.
        rows: (I, S, C), by the weights.
        given: (I, S, p), by the independent parameters, the weights held; None: 0.
    """
    columns = np.ascontiguousarray(rows.transpose(2, 1, 0))  # (C, S, I)
    first, apart = _evenly(position[:, 0]), (position[0] - position[0, 0]).tolist()
    used = [c for c, column in enumerate(columns) if column.any()]
    out, inner, product = (np.zeros(columns.shape[1:]) for _ in range(3))
    for i, c in enumerate(used):
        inner[...] = 0.0
        for d in used[:i]:
            np.multiply(columns[d], _covariance(inverse, first, apart[c], apart[d]), out=product)
            inner += product
        inner *= 2.0
        np.multiply(columns[c], _covariance(inverse, first, apart[c], apart[c]), out=product)
        inner += product
        inner *= columns[c]
        out += inner
    for number, line in enumerate(carried):
        inner[...] = 0.0 if given is None else -given[..., number].T
        for c in used:
            np.multiply(columns[c], _piece(line, first, apart[c]), out=product)
            inner += product
        out += np.square(inner, out=inner)
    return out.T


def _evenly(first: np.ndarray) -> np.ndarray | range:
    """The same places as a range where they are evenly spaced: pieces of lines are views then."""
    step = int(first[1] - first[0])
    return range(int(first[0]), int(first[-1]) + 1, step) if step > 0 and (np.diff(first) == step).all() else first


def _covariance(inverse: Diagonals, first: np.ndarray | range, one: int, other: int) -> np.ndarray:
    """(I,), of the weights at two distances from every first one."""
    line = int(inverse.lines(np.array([abs(one - other)]))[0])
    return _piece(inverse.values[line], first, min(one, other))


def _piece(line: np.ndarray, first: np.ndarray | range, apart: int) -> np.ndarray:
    """(I,), the entries of a line at a distance from every first one."""
    if isinstance(first, range):
        return line[first.start + apart : first.stop + apart : first.step]
    return line[first + apart]
