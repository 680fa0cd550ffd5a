"""The parameters of a structure, one object for each from configuration to tables, their owners, and a vector."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np
import torch

from pinn_cli.runs.reading import printable
from pinn_cli.system.array_namespace import Array
from pinn_cli.system.damping import WHOLE
from pinn_cli.system.priors import Prior
from pinn_cli.system.quantities import CALIBRATION_UNITS

MASS, FACTOR, GAIN = "m", "factor", "gain"
# Standard deviation of the prior of an unknown parameter, in orders of magnitude, where nobody says another one.
PRIOR_WIDTH = 10.0
# Of the linear part of every structure: what they are called, and their units.
LINEAR_UNITS = {MASS: "kg", "c": "N s/m", "k": "N/m"}
LINEAR_TITLES = {MASS: "Mass", "c": "Damping", "k": "Stiffness"}
# Whose a parameter is, where that is no connection.
_OWNERS = {MASS: "DOF", FACTOR: "part", "zeta": "mode"}
# Within mathematics: signs that are letters of a name, as matplotlib has them.
_SIGNS = {sign: rf"\{sign}" for sign in "_%${}"} | {
    "\\": r"\backslash ", "#": r"\sharp ", "^": r"\wedge ", '"': "\N{RIGHT DOUBLE QUOTATION MARK}",
    "`": "\N{LEFT SINGLE QUOTATION MARK}",
}  # fmt: skip
_GREEK_NAMES = ("alpha", "beta", "gamma", "kappa", "mu", "tau", "zeta")

T = TypeVar("T")


@dataclass(frozen=True)
class Parameter:
    """One parameter of a structure or a sensor. Two are equal if they are the same one, whatever is believed of it.

    Attributes:
        kind: ``m``, ``c``, ``k``, ``kappa``, ...
        index: Whose it is among those of its kind, counted from 0: of which mass, connection or sensor.
        prescribed: Prior mean: the value that the user believes in, or where an unknown one starts; NaN where there is
            none.
        prior_std: Prior standard deviation, in the parameter's unit; NaN where there is none.
        scale: Its order of magnitude, the step of gradient methods; None: its value, or its prior standard deviation
            where that is larger.
        said: What the user says of an unknown one, wherever it starts; NaN: nothing.
        unknown: Whether it is to be identified from the record; otherwise it is believed, and its prior may be
            sharpened or widened together with that of all others that are believed.
        positive: Whether it cannot be below zero.
        unit: Powers as ``m^3``; "" where nobody has said.
        title: What a figure calls its kind; "" where it goes by its symbol.
        label: Name of its mass, connection or sensor; "": its number.
        alone: Whether it is the whole structure's, which has one of its kind.
        curve: Of which curve that nobody has a law for it is a term, which says nothing by itself; "": of none.
        prior: Where its posterior distribution is wanted.
    """

    kind: str
    index: int
    prescribed: float = field(default=math.nan, compare=False)
    prior_std: float = field(default=math.nan, compare=False)
    scale: float | None = field(default=None, compare=False)
    said: float = field(default=math.nan, compare=False)
    unknown: bool = field(default=False, compare=False)
    positive: bool = field(default=False, compare=False)
    unit: str = field(default="", compare=False)
    title: str = field(default="", compare=False)
    label: str = field(default="", compare=False)
    alone: bool = field(default=False, compare=False)
    curve: str = field(default="", compare=False)
    prior: Prior | None = field(default=None, compare=False)

    @property
    def signed(self) -> bool:
        """Whether zero is a value like any other; a factor or a gain of zero means that there is nothing."""
        return not self.positive and self.kind not in (FACTOR, GAIN)

    @property
    def may_vanish(self) -> bool:
        """Whether a model with zero in its place is a model like any other: without a cubic term, without an offset."""
        return self.signed or self.kind not in (*LINEAR_UNITS, FACTOR, GAIN)

    @property
    def magnitude(self) -> float:
        """What it would be where it matters: an offset of the signal's size, a spring as strong as the linear one."""
        return self.prior_std / PRIOR_WIDTH if self.scale is None else self.scale

    @property
    def whose(self) -> str:
        """Name or number of its mass, connection or sensor."""
        return self.label or str(self.index + 1)

    @property
    def owner(self) -> str:
        """Whose it is, as people say it: ``DOF 2``, ``connection 2``, ``sensor a1``."""
        if self.kind in CALIBRATION_UNITS:
            return f"sensor {self.whose}"
        if self.alone:
            return "the structure"
        return f"{_OWNERS.get(self.kind, 'connection')} {self.whose}"

    @property
    def name(self) -> str:
        """As tables print it: ``k_2``."""
        return self.kind if self.alone else f"{self.kind}_{self.whose}"

    @property
    def symbol(self) -> str:
        """As mathematics, for matplotlib: ``k_2`` of connection 3 has both numbers below the letter."""
        kind, _, order = self.kind.partition("_")
        if self.alone:
            return f"${letter(self.kind)}$"
        whose = upright(self.label) if self.label else self.whose
        below = f"{upright(order)},{whose}" if order else whose
        return rf"${letter(kind)}_{{{below}}}$"

    @property
    def lower(self) -> float:
        """Most negative distance from the prescribed value, in the parameter's unit."""
        return -self.prescribed if self.positive else -math.inf

    @property
    def step(self) -> float:
        """What a gradient method's steps of the parameter are counted in, in its unit."""
        return max(abs(self.prescribed), self.prior_std) if self.scale is None else self.scale

    def value(self, distance: float) -> float:
        """The parameter at a distance from its prescribed value; never below its bound, whatever the rounding."""
        return float(max(self.prescribed + distance, 0.0 if self.positive else -math.inf))


@dataclass(frozen=True)
class Labels:
    """What a user calls the coordinates and the connections of a structure; of one that is numbered, nothing.

    Attributes:
        dofs: Of the coordinates, n; empty: they go by their numbers, from 1.
        connections: Of all connections, in the order of the groups; empty: they go by their numbers.
        modes: Of the masses and of their springs, where the coordinates are modes and not the DOFs.
        supports: Of the supports that move.
    """

    dofs: tuple[str, ...] = ()
    connections: tuple[str, ...] = ()
    modes: tuple[str, ...] = ()
    supports: tuple[str, ...] = ()

    def connection(self, index: int) -> str:
        """What people call a connection, counted from 0: its name, or its number from 1."""
        return self.connections[index] if self.connections else str(index + 1)

    def owner(self, kind: str, index: int) -> str:
        """Name of the mass, or of the connection counted among all, that has a parameter; "" if it has none."""
        names = (self.modes or self.dofs) if kind == MASS else self.connections
        return names[index] if names else ""

    def setting(self, parameter: Parameter) -> str:
        """Where a user gives a parameter: ``system.k``, or of what has a name ``system.connections.brace.k``."""
        if parameter.kind in WHOLE:
            return "system.damping"
        if not parameter.label:
            return f"system.{parameter.kind}"
        if parameter.label in self.modes:
            return "system.damping_ratio" if parameter.kind == "c" else "system.modes"
        if parameter.kind == FACTOR:
            return f"system.factors.{parameter.label}"
        if parameter.kind == MASS:
            return f"system.mass.{parameter.label}"
        return f"system.connections.{parameter.label}.{parameter.kind}"


def letter(kind: str) -> str:
    """A kind of parameter as mathematics, without dollar signs: ``kappa`` is a Greek letter, ``k_2`` has an index."""
    kind, _, below = kind.partition("_")
    symbol = rf"\{kind}" if kind in _GREEK_NAMES else kind if len(kind) == 1 else upright(kind)
    return rf"{symbol}_{{{upright(below)}}}" if below else symbol


def upright(word: str) -> str:
    """A word, anybody's, within mathematics; what is a sign there, such as _, is a letter."""
    return r"\mathrm{" + "".join(_SIGNS.get(character, character) for character in printable(word)) + "}"


class ParameterVector(Generic[T]):
    """Parameters that may move, as a vector (p,) of distances from where they are prescribed, and as named values.

    Args:
        nominal: Kind to the values of all its members, tensors or arrays alike.
        moving: Those of the vector, p of them.

    Attributes:
        kinds: Those of the moving parameters, in the order of ``nominal``.
        first: Kind to the place of its first member among the members of all :attr:`kinds`.
        places: All members of :attr:`kinds`.
        column: (p,), of each moving parameter among those.
    """

    def __init__(self, nominal: Mapping[str, T], moving: Sequence[Parameter]) -> None:
        self.nominal, self.moving = dict(nominal), tuple(moving)
        self.kinds = tuple(kind for kind in nominal if any(p.kind == kind for p in moving))
        sizes = [len(nominal[kind]) for kind in self.kinds]  # type: ignore[arg-type]
        ends = np.cumsum([0, *sizes]).tolist()
        self.first, self.places = dict(zip(self.kinds, ends, strict=False)), ends[-1]
        self.column = np.array([self.first[p.kind] + p.index for p in self.moving], dtype=np.int64)

    def placed(self, distances: Array) -> Array:
        """(places,), the distances of all members of :attr:`kinds`, 0 of those that are held."""
        if isinstance(distances, np.ndarray):
            placed = np.zeros(self.places)
            placed[self.column] = distances
            return placed
        column = torch.as_tensor(self.column, device=distances.device)
        return distances.new_zeros(self.places).index_copy(0, column, distances)

    def scattered(self, distances: Array) -> dict[str, Array]:
        """Kind to the distances of all its members, 0 of those that are held; of all :attr:`kinds`."""
        placed = self.placed(distances)
        ends = [*self.first.values(), self.places][1:]
        return {kind: placed[first:end] for (kind, first), end in zip(self.first.items(), ends, strict=True)}

    def values(self, distances: Array, nominal: Mapping[str, Array] | None = None) -> dict[str, Array]:
        """Every parameter of the structure by kind, from distances (p,) of the moving ones, in their own units.

        On another device, or of another type, where ``nominal`` are.
        """
        moved, held = self.scattered(distances), self.nominal if nominal is None else nominal
        return {kind: value + moved[kind] if kind in moved else value for kind, value in held.items()}  # type: ignore[operator,misc]

    def each(self, attribute: str) -> np.ndarray:
        """(p,), an attribute of every moving parameter."""
        return np.array([getattr(parameter, attribute) for parameter in self.moving])
