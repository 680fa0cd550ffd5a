"""Damping of a structure as a whole, as engineers state it: a ratio for each mode, or what is proportional to M and K.

    C_d = sum_r 2 zeta_r omega_r M phi_r phi_r' M        ratios
    C_d = a_0 M + a_1 K                                  Rayleigh

phi_r are the modes of M and of the stiffness at rest, phi_r' M phi_r = 1. Either is a sum of dampers with rows b_j of
the incidence and one parameter for each or for several: C_d = sum_j theta_j b_j' b_j. The rows are those of the present
masses and stiffnesses (:meth:`pinn_cli.system.structure.Structure.present`).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.sparse import csr_matrix, diags

from pinn_cli.system.array_namespace import Array
from pinn_cli.system.connection.linear import Linear

WHOLE = RATIO, OF_MASS, OF_STIFFNESS = "zeta", "a_0", "a_1"
DAMPING_TITLES = {RATIO: "Damping ratio", OF_MASS: "Rayleigh damping", OF_STIFFNESS: "Rayleigh damping"}
DAMPING_UNITS = {RATIO: "", OF_MASS: "1/s", OF_STIFFNESS: "s"}


class StructuralDamping(Linear):
    """The law of such dampers, r = theta de; they have no spring.

    Args:
        kind: Of their parameter, in :data:`WHOLE`; of ratios there is one for every mode, the lowest frequency first.
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.parameters = self.nonnegative = (kind,)
        self.titles, self.units = {kind: DAMPING_TITLES[kind]}, {kind: DAMPING_UNITS[kind]}

    def damping_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray | float:
        """See :meth:`Nonlinearity.damping_at_rest`."""
        return parameters[self.kind]

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.force`."""
        return parameters[self.kind] * de

    def rows(self, mass: np.ndarray, stretch: csr_matrix, stiffness: np.ndarray) -> csr_matrix:
        """(C', n), of the incidence: sqrt(2 omega_r) phi_r' M of ratios, sqrt(m_i) of a_0, sqrt(k_j) b_j of a_1.

        Those of a_1 are omega_r phi_r' M where a part is softer than its matrix, as a negative spring. The masses (n,)
        are in kg; ``stretch`` (C, n) and stiffness (C,) at rest, N/m, are of the connections that hold the structure.
        """
        if self.kind == OF_MASS:
            return csr_matrix(diags(np.sqrt(mass)))
        if self.kind == OF_STIFFNESS and (stiffness >= 0).all():
            return csr_matrix(diags(np.sqrt(stiffness)) @ stretch)
        omega, shapes = modes_of_stiffness(mass, stretch, stiffness)
        size = np.sqrt(2.0 * omega) if self.kind == RATIO else omega
        return csr_matrix((size * shapes).T * mass)


def of_ratio(ratio: float, mass: np.ndarray, stretch: csr_matrix, stiffness: np.ndarray) -> dict[str, float]:
    """Kind to the value that gives the lowest and the highest mode a damping ratio."""
    omega, _ = modes_of_stiffness(mass, stretch, stiffness)
    low, high = float(min(omega[omega > 0], default=1.0)), float(omega[-1]) or 1.0
    return {RATIO: ratio, OF_MASS: 2.0 * ratio * low * high / (low + high), OF_STIFFNESS: 2.0 * ratio / (low + high)}


def modes_of_stiffness(mass: np.ndarray, stretch: csr_matrix, stiffness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """rad/s (n,), ascending, 0 of a mode that nothing holds, and shapes (n, n), phi' M phi = 1, by columns."""
    root, dense = np.sqrt(mass), stretch.toarray()
    squares, vectors = np.linalg.eigh((dense / root).T @ (stiffness[:, None] * (dense / root)))
    return np.sqrt(np.maximum(squares, 0.0)), vectors / root[:, None]
