"""From named coordinates and connections, as a user writes them (``system=structure``), to a structure."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from scipy.sparse import csr_matrix, vstack

from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.legal_values import USABLE, entries, is_finite_number, is_usable_number
from pinn_cli.system.building import FIXED_GROUND, check_name, checked_names, damped, law_called, law_settings
from pinn_cli.system.connection.nonlinearity import Nonlinearity
from pinn_cli.system.connection_groups import ConnectionGroup
from pinn_cli.system.coupling import loose_dofs
from pinn_cli.system.incidence import Incidence, Pairs
from pinn_cli.system.parameters import LINEAR_UNITS, MASS, Labels
from pinn_cli.system.structure import Structure

log = logging.getLogger(__name__)

# What a connection says of itself beside its parameters and the settings of its law.
_PLACE = ("between", "weights", "law")


@dataclass(frozen=True, eq=False)
class _Connection:
    """One connection as written: which coordinates stretch it, its law, and its parameters; NaN where unknown."""

    name: str
    weights: dict[int, float]
    law: Nonlinearity
    settings: tuple[tuple[str, str], ...]
    parameters: dict[str, float]

    @property
    def group(self) -> tuple[object, ...]:
        """Connections that have the same are of one law."""
        return self.law.name, type(self.law), self.settings, self.law.parameters


def build_structure(
    dofs: Sequence[str],
    mass: float | Mapping[str, float | None] | None,
    connections: Mapping[str, Mapping[str, Any]],
    kind: str = "structure",
    drifts: Mapping[str, Sequence[str]] | None = None,
    damping: Mapping[str, Any] | None = None,
    supports: Sequence[str] = (),
) -> Structure:
    """A structure of which a value may be missing, null or left out: it is NaN there, see :func:`whole`.

    Of an optional parameter (an order of a polynomial) null says that the connection has it.

    Args:
        dofs: Names of the coordinates.
        mass: Of each, kg; or one number for all.
        connections: Name to ``between: [a, b]`` (its elongation is that of b less that of a; ``ground`` does not move)
            or ``weights: {a: 0.8, b: -0.6}``, ``law``, its settings, and the value of each of its parameters.
        kind: The name of the config group's choice.
        drifts: Name to a pair ``[a, b]`` of coordinates, whose drift is wanted beside those of the connections.
        damping: Of the whole, see :func:`pinn_cli.system.building.damped`; beside it c is 0 unless given.
        supports: Names of supports that move, which connections may join as they join the ground.

    Raises:
        InputError: Naming ``system.<setting>``.
    """
    names, moving = checked_names(dofs), _checked_supports(supports, entries(dofs))
    if moving and damping is not None:
        hint = "it is of the motion beside one ground: give the connections dampers"
        raise InputError("system.damping", dict(damping), "null with system.supports", hint)
    if damping is not None and isinstance(connections, Mapping):
        connections = {
            k: {"c": 0.0, **entry} if isinstance(entry, Mapping) else entry for k, entry in connections.items()
        }
    structure = connected(names, _masses(mass, names), connections, moving)
    tell_if_loose(structure)
    return damped(replace(structure, pairs=drift_pairs(drifts, names, structure)), damping)


def whole(structure: Structure) -> Structure:
    """The structure itself, of which every value has to be given.

    Raises:
        InputError: Naming ``system.<setting>`` of one that is not.
    """
    for parameter in structure.every_parameter():
        if math.isnan(parameter.prescribed):
            setting = structure.labels.setting(parameter)
            hint = "0 is a value; null is for what is unknown of a measured record"
            raise InputError(setting, "nothing", "given", hint)
    return structure


def drift_pairs(drifts: Any, names: tuple[str, ...], structure: Structure) -> Pairs | None:
    """The pairs of ``system.drifts``: name to ``[a, b]`` of DOFs, in a structure whose connections have drifts as well.

    Raises:
        InputError: Naming ``system.drifts`` or one of them.
    """
    if not drifts:
        return None
    if not isinstance(drifts, Mapping):
        raise InputError("system.drifts", drifts, "a map of name: [a, b], such as {roof: [ground, x3]}")
    for name in drifts:
        check_name("system.drifts", name)
        if name in structure.drift_names:
            raise InputError("system.drifts", name, "another name", "a connection is called so, and has a drift")
    weights = [_between(f"system.drifts.{name}", ends, names) for name, ends in drifts.items()]
    return Pairs.of(list(drifts), weights, len(names))


def connected(
    names: tuple[str, ...],
    masses: Sequence[float],
    connections: Mapping[str, Mapping[str, Any]],
    supports: tuple[str, ...] = (),
) -> Structure:
    """The same from names and masses that are checked, whether or not anything holds it.

    Raises:
        InputError: Naming ``system.connections`` and what is in it.
    """
    if not isinstance(connections, Mapping) or not connections:
        allowed = "a map of name: {between: [a, b], law: ..., and its parameters}"
        raise InputError("system.connections", connections, allowed)
    for name in connections:
        check_name("system.connections", name)
    groups: dict[tuple[object, ...], list[_Connection]] = {}
    for connection in [_connection(name, entry, names, supports) for name, entry in connections.items()]:
        groups.setdefault(connection.group, []).append(connection)
    ordered = [connection for members in groups.values() for connection in members]
    parameters = {MASS: list(masses)}
    for connection in ordered:
        for kind, value in connection.parameters.items():
            parameters.setdefault(kind, []).append(value)
    labels = Labels(names, tuple(connection.name for connection in ordered), supports=supports)
    n, ends = len(names), len(names) + len(supports)
    stretch = [Incidence.between([connection.weights for connection in of], ends).matrix for of in groups.values()]
    laws = [members[0].law for members in groups.values()]
    structure = Structure(
        {name: torch.tensor(values, dtype=torch.float64) for name, values in parameters.items()},
        tuple(ConnectionGroup(law, Incidence(matrix[:, :n])) for law, matrix in zip(laws, stretch, strict=True)),
        labels=labels,
        by_supports=csr_matrix(vstack(stretch, format="csr")[:, n:]) if supports else None,
    )
    check_parameters_differ(structure)
    return structure


def _checked_supports(supports: Any, dofs: Sequence[Any]) -> tuple[str, ...]:
    """Names of supports that move."""
    names = entries(supports) if supports is not None else []
    for i, name in enumerate(names):
        check_name("system.supports", name)
        if name == FIXED_GROUND or name in dofs or name in names[:i]:
            raise InputError("system.supports", name, "a name of its own", "ground and system.dofs have theirs")
    return tuple(names)


def _masses(mass: Any, names: tuple[str, ...]) -> list[float]:
    if mass is None or is_finite_number(mass):
        given = dict.fromkeys(names, mass)
    elif isinstance(mass, Mapping):
        given = {str(name): value for name, value in mass.items()}
    else:
        raise InputError("system.mass", mass, "a number, or a map of coordinate: mass in kg")
    for name in given:
        if name not in names:
            raise InputError("system.mass", name, f"one of {', '.join(names)}", suggestion(name, names))
    missing = [name for name in names if name not in given]
    if missing:
        hint = "a coordinate without mass has no equation of motion"
        raise InputError(f"system.mass.{missing[0]}", "nothing", "given", hint)
    return [_value(f"system.mass.{name}", given[name], positive=True) for name in names]


def _value(setting: str, value: Any, positive: bool = False, nonnegative: bool = False) -> float:
    """A parameter as a number; NaN for null."""
    if value is None:
        return math.nan
    if not is_usable_number(value):
        raise InputError(setting, value, f"a number, 0 or {USABLE}")
    if positive and value <= 0:
        raise InputError(setting, value, "> 0", "a coordinate without mass has no equation of motion")
    if nonnegative and value < 0:
        raise InputError(setting, value, ">= 0", "the connection would push itself apart")
    return float(value)


def _connection(name: str, entry: Any, names: tuple[str, ...], supports: tuple[str, ...] = ()) -> _Connection:
    setting = f"system.connections.{name}"
    if not isinstance(entry, Mapping):
        raise InputError(setting, entry, "a map such as {between: [ground, x1], law: linear, c: 10, k: 5e4}")
    weights = _weights(setting, entry, (*names, *supports))
    if min(weights) >= len(names):
        raise InputError(setting, "supports alone", "one of system.dofs at one end", "nothing else can be moved by it")
    if entry.get("law") is None:
        raise InputError(f"{setting}.law", "nothing", "given", "linear is a spring and a damper")
    law_keys = law_settings(entry["law"], f"{setting}.law")
    settings = {key: entry[key] for key in law_keys if key in entry}
    law = law_called(entry["law"], settings, setting)
    try:
        law = law.of_given([str(key) for key in entry])
    except InputError as error:
        raise InputError(setting, error.value, error.allowed) from None
    kinds = (*(kind for kind in LINEAR_UNITS if kind != MASS), *law.parameters)
    allowed_keys = (*_PLACE, *law_keys, *kinds)
    for key in map(str, entry):
        if key not in allowed_keys:
            allowed = f"left out: a {law.name} connection has {', '.join((*kinds, *law_keys))}"
            raise InputError(f"{setting}.{key}", entry[key], allowed, suggestion(key, allowed_keys))
    parameters = {
        kind: _value(f"{setting}.{kind}", entry.get(kind), nonnegative=kind in law.nonnegative) for kind in kinds
    }
    return _Connection(name, weights, law, tuple(sorted((k, str(v)) for k, v in settings.items())), parameters)


def _weights(setting: str, entry: Mapping[str, Any], names: tuple[str, ...]) -> dict[int, float]:
    """Coordinate, counted from 0, to its weight in the elongation; the ground is left out."""
    given = [key for key in ("between", "weights") if entry.get(key) is not None]
    if len(given) != 1:
        allowed = "given either between: [a, b] or weights: {a: 0.8, b: -0.6}"
        raise InputError(setting, " and ".join(given) or "neither", allowed)
    if given == ["between"]:
        return _between(f"{setting}.between", entry["between"], names)
    weights, setting = entry["weights"], f"{setting}.weights"
    if not isinstance(weights, Mapping) or not all(is_usable_number(value) for value in weights.values()):
        raise InputError(setting, weights, "a map of coordinate: weight, such as {a: 0.8, b: -0.6}")
    for name in map(str, weights):
        if name not in names:
            hint = "the ground does not move" if name == FIXED_GROUND else suggestion(name, names)
            raise InputError(setting, name, f"one of {', '.join(names)}", hint)
    if not any(weights.values()):
        raise InputError(setting, dict(weights), "such that one is not 0", "nothing would stretch the connection")
    return {names.index(str(name)): float(weight) for name, weight in weights.items() if weight != 0}


def _between(setting: str, ends: Any, names: tuple[str, ...]) -> dict[int, float]:
    pair = entries(ends)
    if len(pair) != 2:
        raise InputError(setting, ends, "two ends, [a, b]")
    for end in pair:
        if end != FIXED_GROUND and end not in names:
            raise InputError(setting, end, f"{FIXED_GROUND} or one of {', '.join(names)}", suggestion(str(end), names))
    if pair[0] == pair[1]:
        raise InputError(setting, pair, "two different ends", "nothing would stretch the connection")
    return {names.index(end): sign for end, sign in zip(pair, (-1.0, 1.0), strict=True) if end != FIXED_GROUND}


def check_parameters_differ(structure: Structure) -> None:
    """The name of a parameter is its kind and its connection's: two may read the same.

    Raises:
        InputError: Naming ``system.connections``: they do.
    """
    seen: dict[str, str] = {}
    for parameter in structure.every_parameter():
        setting = structure.labels.setting(parameter)
        if parameter.name in seen:
            hint = f"{setting} and {seen[parameter.name]} would both be called {parameter.name}"
            raise InputError("system.connections", parameter.label, "another name", hint)
        seen[parameter.name] = setting


def tell_if_loose(structure: Structure) -> None:
    """Say so where nothing holds the structure."""
    loose = loose_dofs(structure)
    if loose:
        names = ", ".join(structure.labels.owner(MASS, dof) or structure.dof_name(dof) for dof in loose)
        log.warning(
            "the structure is not held: %s can move without stretching any spring (a rigid body's motion)", names
        )
