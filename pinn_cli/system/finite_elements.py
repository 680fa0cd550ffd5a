"""A finite-element model, as a user gives it (``system=matrices``), as a structure in modal coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.sparse import csc_matrix, csr_matrix

from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.legal_values import entries, is_finite_number, is_whole_number, whole_number
from pinn_cli.system.building import checked_names, damped
from pinn_cli.system.connection.linear import Linear
from pinn_cli.system.connection_groups import ConnectionGroup
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.matrix_files import read_matrices
from pinn_cli.system.parameters import FACTOR, MASS, Labels
from pinn_cli.system.reduction import ReducedModel, WholeModel, enriched, reduced_at, reduced_model
from pinn_cli.system.shapes import Shapes
from pinn_cli.system.structure import Structure
from pinn_cli.system.substructures import Parts, check_parts, read_parts, substructures
from pinn_cli.system.topology import check_parameters_differ, connected, drift_pairs, tell_if_loose

# Modal damping that couples the coordinates by less than this part of their own is written without its coupling.
UNCOUPLED = 1e-6


@dataclass(frozen=True, eq=False)
class _Springs:
    """Linear connections: weights of the coordinates (C, n), dampers and springs (C,), names."""

    weights: np.ndarray
    c: np.ndarray
    k: np.ndarray
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class FiniteElements:
    """A finite-element model and how it becomes a structure, whatever coordinates it is reduced to.

    Attributes:
        whole: Before it is reduced.
        names: Of the DOFs that are of interest.
        C: Damping matrix (N, N), N s/m; None: the ratio says it.
        damping_ratio: See :func:`build_finite_elements`.
        parts: Whose stiffness factors multiply.
        added: Connections between the named DOFs; None without any.
        moved: (N,), how far every DOF moves with the ground; None: nobody has said.
    """

    whole: WholeModel
    names: tuple[str, ...]
    C: csc_matrix | None
    damping_ratio: float | Sequence[float] | None
    parts: Parts
    added: Structure | None
    moved: np.ndarray | None

    def structure(self, reduced: ReducedModel) -> Structure:
        """In the coordinates of a reduced model."""
        places, added = self.whole.named, self.added
        springs = _springs(reduced, self.C, self.damping_ratio)
        structure = _with_parts(_assembled(self.names, reduced.vectors[places], springs, added), reduced, self.parts)
        moved, n = self.moved, structure.coordinates
        return replace(
            structure,
            influence=np.zeros(n) if moved is None else reduced.vectors.T @ (self.whole.M @ moved),
            mode_shapes=Shapes(
                reduced.vectors[places],
                None if moved is None else moved[places],
                csr_matrix((0, len(self.names))) if added is None else added.incidence.matrix,
                n - reduced.modes,
            ),
            reduction=CoordinatesOfModel(self, reduced) if self.parts.matrices else None,
        )


@dataclass(frozen=True, eq=False)
class CoordinatesOfModel:
    """The coordinates of a structure whose finite-element model is at hand, see :class:`Structure`."""

    model: FiniteElements
    reduced: ReducedModel

    @cached_property
    def structure(self) -> Structure:
        """As the model gives it."""
        return self.model.structure(self.reduced)

    def at(self, factors: np.ndarray) -> Structure:
        """The model in as many coordinates that are exact where its parts have these factors (P,)."""
        made = self.model.structure(reduced_at(self.model.whole, factors, self.reduced))
        return replace(made, mode_shapes=replace(made.shapes, exact_at=factors))

    def onto(self, other: CoordinatesOfModel) -> np.ndarray:
        """(n, n), from coordinates to those of another reduction of the model."""
        return other.reduced.vectors.T @ (self.model.whole.M @ self.reduced.vectors)


def build_finite_elements(
    dofs: Mapping[str, int],
    path: str | None = None,
    M: str | None = None,
    K: str | None = None,
    C: str | None = None,
    modes: int = 12,
    damping_ratio: float | Sequence[float] | None = None,
    connections: Mapping[str, Mapping[str, Any]] | None = None,
    factors: Mapping[str, Any] | None = None,
    static_correction: Sequence[str] | None = None,
    ground: str | Sequence[int] | None = None,
    drifts: Mapping[str, Sequence[str]] | None = None,
    damping: Mapping[str, Any] | None = None,
    kind: str = "matrices",
    loaded: Sequence[str | int] = (),
    base: Path | None = None,
) -> Structure:
    """A structure in the modal coordinates of M and K; records, sensors and forces belong to its named DOFs.

    A value of a connection that is missing is NaN in the structure.

    Args:
        dofs: Name to the DOF of the matrices, counted from 1.
        path: A file that holds the matrices M and K, and C if there is one.
        M: Or a file for each, kg.
        K: N/m.
        C: N s/m; None: ``damping_ratio`` says it all.
        modes: How many of the lowest ones are kept.
        damping_ratio: Of every mode, 0.01 is one per cent; a list: mode by mode, the last one of all that follow; None
            without a C: nobody has said.
        connections: Between named DOFs and the ground, as in ``system=structure``; None: none.
        factors: Name of a part of K to the file of its stiffness matrix, which a factor multiplies, 1; or to
            ``{file: ..., value: 0.8}`` with another. The dampers stay as they are.
        static_correction: The named DOFs whose static response is kept beside the modes; None: those of connections
            and those that are loaded.
        ground: The DOFs of the matrices that move with the ground by one: numbers, or ``first:last:step``, where
            ``1::2`` is every second one; None: nobody has said.
        drifts: Name to a pair ``[a, b]`` of named DOFs or the ground, whose drift is wanted.
        damping: Of the whole, connections and factors included, see :func:`pinn_cli.system.building.damped`.
        kind: The name of the config group's choice.
        loaded: The named DOFs that carry a force or a sensor, by name or by number from 1: what modes that are left
            out add to a sensor is what a static force there moves.
        base: The folder that relative paths start from; None: the current one.

    Raises:
        InputError: Naming ``system.<setting>``.
    """
    matrices = read_matrices({"M": M, "K": K, "C": C}, path, base)
    for name in ("M", "K"):
        if name not in matrices:
            raise InputError(f"system.{name}", "nothing", "given", "or system.path, a file that holds both")
    size = matrices["M"].shape[0]
    names, places = _named(dofs, size)
    modes = whole_number("system.modes", modes, least=1)
    added = connected(names, [1.0] * len(names), connections) if connections else None
    static = np.unique(places[_static(names, static_correction, added, loaded)])
    parts = read_parts(factors, path, size, base)
    model = WholeModel(matrices["M"], matrices["K"], tuple(parts.matrices.values()), static, places)
    reduced = reduced_model(model.M, model.K, modes, static)
    if parts.matrices:
        check_parts(reduced, parts)
        reduced = enriched(model, reduced)
    if damping is not None and (damping_ratio is not None or "C" in matrices):
        given = "C" if "C" in matrices else f"system.damping_ratio={damping_ratio}"
        raise InputError("system.damping", damping, f"null beside {given}", "each says all of the damping")
    ratio = damping_ratio if damping is None else 0.0
    moved = None if ground is None else _moved_by_ground(ground, size)
    structure = FiniteElements(model, names, matrices.get("C"), ratio, parts, added, moved).structure(reduced)
    check_parameters_differ(structure)
    tell_if_loose(structure)
    return damped(replace(structure, pairs=drift_pairs(drifts, names, structure)), damping)


def _named(dofs: Any, size: int) -> tuple[tuple[str, ...], np.ndarray]:
    """Names of DOFs and their places among those of the matrices, counted from 0."""
    if not isinstance(dofs, Mapping) or not dofs:
        raise InputError("system.dofs", dofs, "a map of name: DOF, such as {tip: 399}", "DOFs are counted from 1")
    names = checked_names(list(dofs))
    for name, dof in dofs.items():
        if not is_whole_number(dof) or not 1 <= dof <= size:
            raise InputError(f"system.dofs.{name}", dof, f"a DOF from 1 to {size}", f"M is {size} x {size}")
        twin = next(other for other, at in dofs.items() if at == dof)
        if twin != name:
            raise InputError(f"system.dofs.{name}", dof, "another DOF", f"{twin} is DOF {dof} as well")
    return names, np.array([int(dof) - 1 for dof in dofs.values()])


def _static(names: tuple[str, ...], chosen: Any, added: Structure | None, loaded: Sequence[str | int]) -> np.ndarray:
    """(s,) of the named DOFs, counted from 0, those whose static response is kept."""
    if chosen is None:
        dofs = set() if added is None else set(added.incidence.matrix.indices.tolist())
        for dof in loaded:
            # Of a number that is none of a DOF the force's own setting speaks.
            dofs |= {names.index(dof)} if isinstance(dof, str) and dof in names else set()
            dofs |= {dof - 1} if isinstance(dof, int) and 1 <= dof <= len(names) else set()
        return np.array(sorted(dofs), dtype=np.int64)
    for name in entries(chosen):
        if name not in names:
            hint = suggestion(str(name), names)
            raise InputError("system.static_correction", name, f"names of {', '.join(names)}", hint)
    return np.array([names.index(name) for name in entries(chosen)], dtype=np.int64)


def _springs(reduced: ReducedModel, C: csc_matrix | None, damping_ratio: Any) -> _Springs:
    """The modes' own springs and dampers, and dampers that couple them where C is not diagonal in them."""
    n, k = len(reduced.stiffness), reduced.stiffness
    residual = n - reduced.modes
    names = [f"mode_{i + 1}" for i in range(reduced.modes)] + [f"residual_{i + 1}" for i in range(residual)]
    weights = np.eye(n)
    if C is None:
        return _Springs(weights, 2.0 * _ratios(damping_ratio, n) * np.sqrt(k), k, tuple(names))
    if damping_ratio is not None:
        raise InputError("system.damping_ratio", damping_ratio, "null where there is a C", "C holds the damping")
    damping = reduced.vectors.T @ (C @ reduced.vectors)
    c, coupling = np.diag(damping).copy(), damping - np.diag(np.diag(damping))
    if np.abs(coupling).max(initial=0.0) <= UNCOUPLED * np.abs(c).max(initial=0.0):
        return _Springs(weights, c, k, tuple(names))
    values, vectors = np.linalg.eigh(damping)
    names += [f"damper_{i + 1}" for i in range(n)]
    nothing = np.zeros(n)
    coupled = np.vstack([weights, vectors.T])
    return _Springs(coupled, np.append(nothing, values), np.append(k, nothing), tuple(names))


def _ratios(given: Any, n: int) -> np.ndarray:
    """(n,), NaN where nobody has said."""
    if given is None:
        return np.full(n, np.nan)
    values = [given] if is_finite_number(given) else entries(given)
    if not values or len(values) > n or not all(is_finite_number(x) and 0 <= x < 1 for x in values):
        raise InputError("system.damping_ratio", given, f"a number from 0 to below 1, or a list of at most {n}")
    return np.array([*values, *[values[-1]] * (n - len(values))], dtype=np.float64)


def _moved_by_ground(ground: Any, size: int) -> np.ndarray:
    """(N,), 1 for every DOF of the matrices that moves with the ground."""
    allowed = f"DOFs from 1 to {size}: a list, or first:last:step, such as 1::2"
    moved = np.zeros(size)
    if isinstance(ground, str):
        parts = ground.split(":")
        if not 2 <= len(parts) <= 3 or not all(part == "" or part.isdecimal() for part in parts):
            raise InputError("system.ground", ground, allowed)
        first, last, step = (int(part) if part else None for part in (*parts, "")[:3])
        dofs = list(range(1 if first is None else first, (size if last is None else last) + 1, step or 1))
    else:
        dofs = entries(ground)
    if not dofs or not all(is_whole_number(dof) and 1 <= dof <= size for dof in dofs):
        raise InputError("system.ground", ground, allowed)
    moved[np.array(dofs) - 1] = 1.0
    return moved


def _assembled(names: tuple[str, ...], shapes: np.ndarray, springs: _Springs, added: Structure | None) -> Structure:
    """The modes' springs first, then the user's connections, in the modes' coordinates."""
    n = shapes.shape[1]
    groups = [ConnectionGroup(Linear(), Incidence(csr_matrix(springs.weights)))]
    parameters = {MASS: torch.ones(n, dtype=torch.float64), "c": torch.tensor(springs.c), "k": torch.tensor(springs.k)}
    connections = springs.names
    if added is not None:
        for group in added.groups:
            stretched = np.asarray(group.incidence.matrix @ shapes)
            groups.append(ConnectionGroup(group.nonlinearity, Incidence(csr_matrix(stretched))))
        for name, values in added.parameters.items():
            if name != MASS:
                parameters[name] = torch.cat([parameters[name], values]) if name in parameters else values
        connections += added.labels.connections
    return Structure(parameters, tuple(groups), Labels(names, connections, springs.names[:n]))


def _with_parts(structure: Structure, reduced: ReducedModel, parts: Parts) -> Structure:
    """The same with the connections of its parts behind all others, which so keep their numbers."""
    if not parts.matrices:
        return structure
    labels, part_names = structure.labels, list(parts.matrices)
    for name in part_names:
        if name in labels.connections:
            raise InputError("system.factors", name, "another name", "a connection is called so")
    group = substructures(reduced, parts)
    whose = tuple(part_names[part] for part in group.shares)
    factors = torch.tensor([parts.factors[name] for name in part_names], dtype=torch.float64)
    return replace(
        structure,
        parameters={**structure.parameters, FACTOR: factors},
        groups=(*structure.groups, group),
        labels=replace(labels, connections=(*labels.connections, *whose)),
    )
