"""Parts of a finite-element model whose stiffness may differ from its matrix by a factor, the same all over the part.

    K = K_0 + sum_j (factor_j - 1) K_j

K_0 is the whole matrix, as given, and K_j = L_j' L_j that of a part, both in modal coordinates. So a part is as many
connections as L_j has rows, e = L_j q, with the force (factor_j - 1) e and one parameter for all of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import is_finite_number
from pinn_cli.system.array_namespace import Array
from pinn_cli.system.building import check_name
from pinn_cli.system.connection.linear import Linear
from pinn_cli.system.connection_groups import ConnectionGroup
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.matrix_files import read_matrices
from pinn_cli.system.parameters import FACTOR
from pinn_cli.system.reduction import RIGID_EIGENVALUE, ReducedModel

# Parts of a mode's strain energy: less than the first is no part of it, and more than the second is an error.
NO_PART, PART_ROUNDING = 1e-10, 1e-6


class Substructure(Linear):
    """The law of a part's connections: what its stiffness is more than the matrix says, r = (factor - 1) e."""

    parameters = (FACTOR,)
    titles: Mapping[str, str] = {FACTOR: "Stiffness factor"}
    nonnegative = (FACTOR,)

    def stiffness_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray | float:
        """See :meth:`Nonlinearity.stiffness_at_rest`."""
        return parameters[FACTOR] - 1.0

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.force`."""
        return (parameters[FACTOR] - 1.0) * e


@dataclass(frozen=True, eq=False)
class Parts:
    """Substructures as a user gives them.

    Attributes:
        matrices: Name to the part of K, N/m.
        factors: Of each: what it is, or is believed to be.
    """

    matrices: dict[str, csc_matrix]
    factors: dict[str, float]


def read_parts(factors: Any, path: Any, size: int, base: Path | None = None) -> Parts:
    """The matrices of ``system.factors``, of so many DOFs: name to a file, or to a map of ``file`` and ``value``.

    Without a file it is looked for in ``path``, see :func:`pinn_cli.system.matrix_files.read_matrices`.

    Raises:
        InputError: Naming ``system.factors`` or one of them.
    """
    if not factors:
        return Parts({}, {})
    if not isinstance(factors, Mapping):
        raise InputError("system.factors", factors, "a map of name: file, such as {K_2: K2.mtx}")
    matrices, values = {}, {}
    for name, given in factors.items():
        setting = f"system.factors.{name}"
        check_name("system.factors", name)
        entry = dict(given) if isinstance(given, Mapping) else {"file": given}
        value = entry.pop("value", 1.0)
        file = entry.pop("file", None)
        if entry:
            raise InputError(f"{setting}.{next(iter(entry))}", next(iter(entry.values())), "left out: file and value")
        if not is_finite_number(value) or value <= 0:
            raise InputError(f"{setting}.value", value, "a number > 0", "1 is the stiffness of the matrix")
        matrices[name], values[name] = _matrix(setting, name, file, path, size, base), float(value)
    return Parts(matrices, values)


def _matrix(setting: str, name: str, file: Any, path: Any, size: int, base: Path | None) -> csc_matrix:
    if file is None and path is None:
        raise InputError(setting, "nothing", "the name of a file", "or system.path, a file that holds it")
    matrix = read_matrices({name: file}, path, base, settings={name: setting})[name]
    if matrix.shape[0] != size:
        hint = "the matrix of a part has the DOFs of the whole, zeros where it has no stiffness"
        raise InputError(setting, f"{matrix.shape[0]} x {matrix.shape[0]}", f"as large as K, {size} x {size}", hint)
    return matrix


def check_parts(reduced: ReducedModel, parts: Parts) -> None:
    """See that the parts are parts, as far as a reduced model tells.

    Raises:
        InputError: Naming ``system.factors`` or one of them: it has negative eigenvalues, the model cannot feel it, or
            all parts together are stiffer than K.
    """
    together = np.zeros((len(reduced.stiffness),) * 2)
    for name, matrix in parts.matrices.items():
        energy = _energies(reduced, matrix)
        values = np.linalg.eigvalsh(energy)
        if values[0] < -PART_ROUNDING * max(1.0, values[-1]):
            hint = f"a push against it gives energy back: an eigenvalue is {values[0]:.2g} times the mode's stiffness"
            raise InputError(f"system.factors.{name}", name, "positive semidefinite", hint)
        if values[-1] < PART_ROUNDING:
            hint = "no mode that is kept bends it: is it a matrix of zeros, or are there more modes to keep?"
            raise InputError(f"system.factors.{name}", name, "a part that the modes bend", hint)
        together += energy
    most = float(np.linalg.eigvalsh(together)[-1]) if parts.matrices else 0.0
    if most > 1.0 + PART_ROUNDING:
        hint = f"a shape has {most:.3g} times its strain energy in them: is a part there twice, or in other units?"
        raise InputError("system.factors", ", ".join(parts.matrices), "parts whose sum is not stiffer than K", hint)


def _energies(reduced: ReducedModel, matrix: csc_matrix) -> np.ndarray:
    """(n, n), the part's stiffness over those of the modes: a quadratic form whose values are shares of energy."""
    root = _stiffness_roots(reduced)
    energies: np.ndarray = reduced.vectors.T @ (matrix @ reduced.vectors) / np.outer(root, root)
    return (energies + energies.T) * 0.5


def _stiffness_roots(reduced: ReducedModel) -> np.ndarray:
    """(n,), rad/s, of the coordinates; of a rigid body's, which no part may stiffen, what counts as none."""
    stiffness = reduced.stiffness
    return np.sqrt(np.maximum(stiffness, RIGID_EIGENVALUE * float(stiffness.max())))


def substructures(reduced: ReducedModel, parts: Parts) -> ConnectionGroup:
    """The connections of all parts, in the coordinates of a reduced model."""
    rows, whose = [], []
    for number, matrix in enumerate(parts.matrices.values()):
        values, vectors = np.linalg.eigh(_energies(reduced, matrix))
        kept = values > NO_PART
        rows.append(np.sqrt(values[kept, None]) * vectors[:, kept].T * _stiffness_roots(reduced))
        whose += [number] * int(kept.sum())
    return ConnectionGroup(Substructure(), Incidence(csr_matrix(np.vstack(rows))), tuple(whose))
