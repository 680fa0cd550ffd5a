"""The density of a motion that white forces make: the determinant of the equations that turn the motion into forces.

What is probable is a force; of a motion it is that density times |det L|, with L the linearised equations, the motion
at the beginning being free. It is a sum over the frequencies omega that the features follow (Szegoe's limit theorem),

    log |det L| = sum of log |det(-omega^2 M + i omega C + K)|.

A damper adds T c / 2 m to it. Left out, the record is the more probable the less its structure is damped, and a
discrepancy that lets damping go is found where there is none.

Averages of a spline of even degree p over its knot intervals see omega^j as the sum over its aliases omega_k of
omega_k^j (omega / omega_k)^(p + 2): that matters in the uppermost part of the features' band.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, reverse_cuthill_mckee

# Aliases of a frequency on either side: of the furthest a power of eight or more is nothing.
ALIASES = 4
# Numbers that are held at once.
AT_ONCE = 1_000_000


def seen_powers(count: int, edge: float, degree: int | None) -> np.ndarray:
    """(3, count), 1, omega and omega^2 of frequencies up to an edge (rad/s), as averages over intervals see them.

    Args:
        count: Of the frequencies: as many as the averages.
        edge: Where the features' band ends.
        degree: Of a spline whose averages they are; None where the equations hold at points.
    """
    omega = edge * (np.arange(count) + 0.5) / count
    powers = np.arange(3)[:, None]
    if degree is None:
        return np.asarray(omega**powers)
    aliases = omega + 2.0 * edge * np.arange(-ALIASES, ALIASES + 1)[:, None]
    return np.asarray((aliases ** powers[..., None] * (omega / aliases) ** (degree + 2)).sum(1))


def log_density(mass: np.ndarray, damping: np.ndarray, stiffness: np.ndarray, seen: np.ndarray) -> float:
    """Sum over frequencies of log |det(-omega^2 M + i omega C + K)|.

    Functions that feel each other are taken together: an input is felt by the motion, and does not feel it.

    Args:
        mass: (n,), of every function's second derivative in its own equation.
        damping: (n, n), row by row of the equations.
        stiffness: Likewise.
        seen: See :func:`seen_powers`.
    """
    terms = stiffness, damping, -np.diag(mass)
    coupled = csr_matrix(sum(term != 0 for term in terms))
    number, member = connected_components(coupled, connection="strong")
    total = 0.0
    for component in range(number):
        own = np.flatnonzero(member == component)
        own = own[reverse_cuthill_mckee(csr_matrix(coupled[np.ix_(own, own)]))]
        total += _of_coupled([term[np.ix_(own, own)] for term in terms], seen)
    return total


def _of_coupled(terms: list[np.ndarray], seen: np.ndarray) -> float:
    """The same of functions that all feel each other, in an order in which those that do are near: by elimination."""
    size = len(terms[0])
    row, column = np.nonzero(sum(term != 0 for term in terms))
    reach = int(np.abs(row - column).max(initial=0))
    chunk = max(1, AT_ONCE // (size * (2 * reach + 1)))
    total = 0.0
    for start in range(0, seen.shape[1], chunk):
        zeroth, first, second = seen[:, start : start + chunk]
        band = np.zeros((size, 2 * reach + 1, len(zeroth)), dtype=complex)
        stiffness, damping, inertia = (term[row, column][:, None] for term in terms)
        band[row, column - row + reach] = stiffness * zeroth + 1j * damping * first + inertia * second
        for i in range(size):
            for below in range(1, min(reach, size - 1 - i) + 1):
                factor = band[i + below, reach - below] / band[i, reach]
                band[i + below, reach - below + 1 : 2 * reach - below + 1] -= factor * band[i, reach + 1 :]
        total += float(np.log(np.abs(band[:, reach])).sum())
    return total
