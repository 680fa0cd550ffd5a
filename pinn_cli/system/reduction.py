"""From the matrices of a finite-element model to a few coordinates: its lowest modes, and static responses beside them.

The coordinates are orthonormal in M and orthogonal in K: each is a mass of one on a spring omega^2. To the lowest modes
come the residual vectors of chosen DOFs, what a constant force there moves beyond those modes: with them the reduced
model bends at those DOFs as the whole one does, however few modes there are. Where parts of the model may be softer or
stiffer than they are said to be, shapes that only the changed model takes come beside them as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import LinearOperator, SuperLU, eigsh, splu

from pinn_cli.settings.errors import InputError

# Up to here, and where most modes are wanted, a dense eigenproblem is solved.
DENSE = 600
# K is shifted by so much of its size against M, so that a body that nothing holds can be solved for as well.
SHIFT = 1e-12
# A residual vector with less than this of its force left, or of the largest residual vector, is in the modes already.
SPANNED, DEPENDENT = 1e-8, 1e-10
# An eigenvalue of this part of the largest found, or nearer to zero, is a rigid body's: its stiffness is rounding.
RIGID_EIGENVALUE = 1e-9
# Parts are tried at these factors, one at a time. The shapes that are added leave out no more than this of the energy
# of any mode of the models so changed: that is the error of its frequency squared.
FACTORS, ENERGY_LEFT_OUT = (0.7, 1.3), 1e-3


@dataclass(frozen=True, eq=False)
class WholeModel:
    """What is reduced.

    Attributes:
        M: Mass matrix (N, N), kg.
        K: Stiffness matrix (N, N), N/m.
        parts: P of K, N/m, which factors may multiply.
        static: (s,), the DOFs whose static response is kept, counted from 0.
        named: (d,), those whose motion is of interest.
    """

    M: csc_matrix
    K: csc_matrix
    parts: tuple[csc_matrix, ...]
    static: np.ndarray
    named: np.ndarray


@dataclass(frozen=True, eq=False)
class ReducedModel:
    """A finite-element model in orthonormal coordinates.

    Attributes:
        vectors: (DOFs, n), M-orthonormal: first the modes, then what comes beside them.
        stiffness: (n,), omega^2, (rad/s)^2.
        modes: How many of the coordinates are modes.
    """

    vectors: np.ndarray
    stiffness: np.ndarray
    modes: int


def reduced_model(M: csc_matrix, K: csc_matrix, modes: int, static: np.ndarray) -> ReducedModel:
    """So many of the lowest modes, and what constant forces on some DOFs (s,), from 0, move beyond them.

    M is the mass matrix (N, N), kg, and K the stiffness matrix, N/m.

    Raises:
        InputError: M is not positive definite; K has negative eigenvalues; more modes than DOFs.
    """
    size = M.shape[0]
    if modes > size:
        raise InputError("system.modes", modes, f"at most {size}", f"the model has {size} DOFs")
    _check_positive(M)
    values, vectors, shifted, shift = _modes(M, K, modes)
    least = RIGID_EIGENVALUE * max(float(np.abs(values).max()), shift)
    if values.min() < -max(least, 10.0 * shift):
        allowed = "without negative eigenvalues"
        raise InputError("system.K", f"a K whose lowest eigenvalue is {values.min():.3g} (rad/s)^2", allowed)
    values = np.where(values < least, 0.0, values)
    more, stiffness = _residual_vectors(M, K, vectors, shifted, static)
    return _model(vectors, values, more, stiffness)


def enriched(model: WholeModel, reduced: ReducedModel) -> ReducedModel:
    """A reduced model with shapes that the whole one takes where parts of it are softer or stiffer."""
    M, K, modes = model.M, model.K, reduced.modes
    energies, shapes = _changed_shapes(M, K, model.parts, reduced, model.static)
    changed = shapes[:, np.cumsum(energies) > ENERGY_LEFT_OUT]
    vectors, values = reduced.vectors[:, :modes], reduced.stiffness[:modes]
    return _model(vectors, values, *_complement(M, K, vectors, np.hstack([reduced.vectors[:, modes:], changed])))


def reduced_at(model: WholeModel, factors: np.ndarray, like: ReducedModel) -> ReducedModel:
    """As many coordinates as another reduced model has, that are exact where parts of the model are softer or stiffer.

    They hold the modes so changed and the static responses of chosen DOFs, then as many shapes as there are parts that
    it takes beside these factors, then static responses of the DOFs that are of interest and higher modes in turn. As
    in all reduced models, they are orthogonal in K itself. The factors (P,), > 0, are on the stiffness of the parts.

    Raises:
        InputError: So changed, the model has no modes.
    """
    M, parts, count = model.M, model.parts, len(like.stiffness)
    changed = csc_matrix(model.K + sum((f - 1.0) * part for f, part in zip(factors, parts, strict=True)))
    modes = min(count + 1, M.shape[0])
    _, vectors, shifted, _ = _modes(M, changed, modes)
    kept, higher = vectors[:, : like.modes], vectors[:, like.modes :]
    exact = reduced_model(M, changed, like.modes, model.static)
    changes = [f * part for f, part in zip(factors, parts, strict=True)]
    changed_shapes = _changed_shapes(M, changed, changes, exact, model.static)[1][:, ::-1][:, : len(parts)]
    residual_vectors = _residual_vectors(M, changed, kept, shifted, model.named)[0]
    turns = min(residual_vectors.shape[1], higher.shape[1])
    in_turn = np.stack([residual_vectors[:, :turns], higher[:, :turns]], axis=2).reshape(len(vectors), -1)
    rest = [in_turn, residual_vectors[:, turns:], higher[:, turns:], like.vectors]
    basis = _orthonormal(M, kept, np.hstack([exact.vectors[:, like.modes :], changed_shapes, *rest]), count)
    stiffness, turned = np.linalg.eigh(basis.T @ (model.K @ basis))
    stiffness = np.where(stiffness < RIGID_EIGENVALUE * stiffness.max(), 0.0, stiffness)
    nothing = np.empty((len(basis), 0))
    return replace(_model(basis @ turned, stiffness, nothing, nothing[0]), modes=like.modes)


def _orthonormal(M: csc_matrix, basis: np.ndarray, shapes: np.ndarray, count: int) -> np.ndarray:
    """M-orthonormal vectors (N, b) and what the first of some shapes (N, s) are beyond them, until there are so many.

    Shapes that are within those before them are left out.
    """
    for shape in shapes.T:
        if basis.shape[1] == count:
            break
        residual = shape / np.sqrt(shape @ (M @ shape))
        for _ in range(2):  # once leaves the rounding of what it took away
            residual = residual - basis @ (basis.T @ (M @ residual))
        size = float(residual @ (M @ residual))
        if size > DEPENDENT:
            basis = np.column_stack([basis, residual / np.sqrt(size)])
    return basis


def _model(vectors: np.ndarray, values: np.ndarray, more: np.ndarray, stiffness: np.ndarray) -> ReducedModel:
    """Modes and what comes beside them, each with its stiffness; the sign of every vector is that of its largest."""
    basis = np.hstack([vectors, more])
    largest = basis[np.abs(basis).argmax(axis=0), np.arange(basis.shape[1])]
    return ReducedModel(basis * np.sign(largest), np.concatenate([values, stiffness]), len(values))


def _modes(M: csc_matrix, K: csc_matrix, modes: int) -> tuple[np.ndarray, np.ndarray, SuperLU, float]:
    """Eigenvalues (modes,), ascending, and M-orthonormal vectors (N, modes), with the factors of K + shift M.

    The shift, (rad/s)^2, comes last.
    """
    size, shift = M.shape[0], SHIFT * float(K.diagonal().max(initial=0.0) / M.diagonal().mean()) or 1.0
    try:
        shifted = splu(csc_matrix(K + shift * M))
    except RuntimeError:
        raise InputError("system.K", "a K that cannot be solved", "positive semidefinite") from None
    if size > DENSE and 2 * modes < size:
        solve = LinearOperator((size, size), matvec=shifted.solve, dtype=np.float64)
        start = np.random.default_rng(0).standard_normal(size)
        values, vectors = eigsh(K, modes, M, sigma=-shift, OPinv=solve, v0=start)
        order = np.argsort(values)
        return values[order], vectors[:, order], shifted, shift
    try:  # the inverse problem, whose largest eigenvalues are the ones that come out precisely
        inverse, vectors = eigh(M.toarray(), (K + shift * M).toarray(), subset_by_index=(size - modes, size - 1))
    except np.linalg.LinAlgError:
        raise InputError("system.K", "a K with negative eigenvalues", "positive semidefinite") from None
    return (1.0 / inverse - shift)[::-1], (vectors / np.sqrt(inverse))[:, ::-1], shifted, shift


def _changed_shapes(
    M: csc_matrix, K: csc_matrix, parts: Sequence[csc_matrix], reduced: ReducedModel, static: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(r,) energies, ascending, and shapes (N, r): modes and static responses of the changed model beyond the model's.

    The shapes have unit energy, so that the squared singular values of what is left, in the norm of energy, are errors
    of frequencies squared; a proper orthogonal decomposition orders what is left.
    """
    shapes = []
    for part in parts:
        for factor in FACTORS:
            values, vectors, shifted, shift = _modes(M, csc_matrix(K + (factor - 1.0) * part), reduced.modes)
            bends = values > max(RIGID_EIGENVALUE * float(np.abs(values).max()), 10.0 * shift)
            unit_energy = vectors[:, bends] / np.sqrt(values[bends])
            beyond = _forces_beyond(M, vectors, static)
            moved = shifted.solve(beyond)
            energy = np.sum(beyond * moved, axis=0) + np.sum(unit_energy[static] ** 2, axis=1)
            shapes += [unit_energy, moved / np.sqrt(energy)]
    basis, residual = reduced.vectors, np.hstack(shapes)
    residual = residual - basis @ (basis.T @ (M @ residual))
    energies, turned = np.linalg.eigh(residual.T @ (K @ residual))
    return energies, residual @ turned


def _check_positive(M: csc_matrix) -> None:
    """Pivots of a symmetric elimination are all positive where a matrix is positive definite."""
    hint = "a DOF without mass? condense it, or give it a small mass"
    massless = np.flatnonzero(M.diagonal() <= 0.0)
    if massless.size:
        raise InputError("system.M", f"{M.diagonal()[massless[0]]:g} kg at DOF {massless[0] + 1}", "> 0", hint)
    try:
        factor = splu(M, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        positive = bool((factor.U.diagonal() > 0).all() and np.array_equal(factor.perm_r, factor.perm_c))
    except RuntimeError:  # exactly singular
        positive = False
    if not positive:
        raise InputError("system.M", "a mass matrix that is not positive definite", "a positive definite one", hint)


def _residual_vectors(
    M: csc_matrix, K: csc_matrix, vectors: np.ndarray, shifted: SuperLU, static: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(N, s) orthonormal vectors beyond the modes, and their stiffnesses (s,), ascending."""
    beyond = _forces_beyond(M, vectors, static)
    return _complement(M, K, vectors, shifted.solve(beyond[:, np.linalg.norm(beyond, axis=0) > SPANNED]))


def _forces_beyond(M: csc_matrix, vectors: np.ndarray, static: np.ndarray) -> np.ndarray:
    """(N, s), what unit forces on some DOFs (s,) are beyond those that move modes (N, m)."""
    unit = np.zeros((M.shape[0], len(static)))
    unit[static, np.arange(len(static))] = 1.0
    return np.asarray(unit - M @ (vectors @ vectors[static].T))


def _complement(M: csc_matrix, K: csc_matrix, vectors: np.ndarray, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, s) orthonormal vectors that hold what shapes (N, t) are beyond some vectors, and their stiffnesses (s,).

    None where the vectors are all that there are.
    """
    moved = moved - vectors @ (vectors.T @ (M @ moved))
    moved /= np.sqrt(np.sum(moved * (M @ moved), axis=0))
    size, turned = np.linalg.eigh(moved.T @ (M @ moved))
    kept = size > DEPENDENT * size.max(initial=0.0)
    basis = moved @ (turned[:, kept] / np.sqrt(size[kept]))
    stiffness, turned = np.linalg.eigh(basis.T @ (K @ basis))
    return basis @ turned, stiffness
