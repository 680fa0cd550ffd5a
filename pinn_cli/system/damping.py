"""Damping of a structure as a whole, as engineers state it: a ratio for each mode, or what is proportional to M and K.

    C_d = sum_r 2 zeta_r omega_r M phi_r phi_r' M        ratios
    C_d = a_0 M + a_1 K                                  Rayleigh

phi_r are the modes of M and of the stiffness at rest, phi_r' M phi_r = 1. Either is a sum of dampers with rows b_j of
the incidence and one parameter for each or for several: C_d = sum_j theta_j b_j' b_j. The rows are those of the present
masses and stiffnesses (:meth:`pinn_cli.system.structure.Structure.present`).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from scipy.sparse import csr_matrix, diags

from pinn_cli.system.array_namespace import Array
from pinn_cli.system.connection.linear import Linear

WHOLE = RATIO, OF_MASS, OF_STIFFNESS = "zeta", "a_0", "a_1"


class StructuralDamping(Linear):
    """The law of such dampers, r = theta de; they have no spring.

    Attributes:
        kind: Of their parameter.
    """

    kind: ClassVar[str]

    def damping_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray | float:
        """See :meth:`Nonlinearity.damping_at_rest`."""
        return parameters[self.kind]

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.force`."""
        return parameters[self.kind] * de

    @abstractmethod
    def rows(self, mass: np.ndarray, stretch: csr_matrix, stiffness: np.ndarray) -> csr_matrix:
        """(C', n), of the incidence.

        Args:
            mass: (n,), kg.
            stretch: (C, n), of the connections that hold the structure.
            stiffness: (C,), theirs at rest, N/m.
        """


class ModalRatios(StructuralDamping):
    """A damping ratio for every mode, the lowest frequency first: rows sqrt(2 omega_r) phi_r' M."""

    kind = RATIO
    parameters = nonnegative = (RATIO,)
    titles: Mapping[str, str] = {RATIO: "Damping ratio"}
    units: Mapping[str, str] = {RATIO: ""}

    def rows(self, mass: np.ndarray, stretch: csr_matrix, stiffness: np.ndarray) -> csr_matrix:
        """See :meth:`StructuralDamping.rows`."""
        omega, shapes = modes_of_stiffness(mass, stretch, stiffness)
        return csr_matrix((np.sqrt(2.0 * omega) * shapes).T * mass)


class MassProportional(StructuralDamping):
    """a_0 M: rows sqrt(m_i)."""

    kind = OF_MASS
    parameters = nonnegative = (OF_MASS,)
    titles: Mapping[str, str] = {OF_MASS: "Rayleigh damping"}
    units: Mapping[str, str] = {OF_MASS: "1/s"}

    def rows(self, mass: np.ndarray, stretch: csr_matrix, stiffness: np.ndarray) -> csr_matrix:
        """See :meth:`StructuralDamping.rows`."""
        return csr_matrix(diags(np.sqrt(mass)))


class StiffnessProportional(StructuralDamping):
    """a_1 K: rows sqrt(k_j) b_j; omega_r phi_r' M where a part is softer than its matrix, as a negative spring."""

    kind = OF_STIFFNESS
    parameters = nonnegative = (OF_STIFFNESS,)
    titles: Mapping[str, str] = {OF_STIFFNESS: "Rayleigh damping"}
    units: Mapping[str, str] = {OF_STIFFNESS: "s"}

    def rows(self, mass: np.ndarray, stretch: csr_matrix, stiffness: np.ndarray) -> csr_matrix:
        """See :meth:`StructuralDamping.rows`."""
        if (stiffness >= 0).all():
            return csr_matrix(diags(np.sqrt(stiffness)) @ stretch)
        omega, shapes = modes_of_stiffness(mass, stretch, stiffness)
        return csr_matrix((omega * shapes).T * mass)


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
