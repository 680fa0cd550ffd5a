"""One record's part in a solution of several: all that is as long as the record stays with it.

The parts are computed side by side, perhaps in other processes. So what comes and goes are arrays: a place among the
unknowns, noise levels, and the few numbers about the parameters that the records have in common.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import torch

from pinn_cli.training.band.bordered import BorderedFactor, BorderedSystem, Eliminated
from pinn_cli.training.band.discrepancy_search import Trained
from pinn_cli.training.band.evidence import Evidence, occupied_share
from pinn_cli.training.band.levenberg_marquardt import Solution
from pinn_cli.training.band.point import Point
from pinn_cli.training.noise_model import NoiseModel

V = TypeVar("V")

# Points that a member keeps: the last accepted one, and the one that is tried. Of systems and factors, which are
# larger, it keeps one.
POINTS_KEPT = 2


@dataclass(frozen=True, eq=False)
class Place:
    """Where one record stands among its unknowns.

    Attributes:
        number: The same for the same place.
        unknowns: (size,), readout weights.
        parameters: (p,), those of this record.
    """

    number: int
    unknowns: np.ndarray
    parameters: np.ndarray


@dataclass(frozen=True, eq=False)
class SystemKey:
    """One record's normal equations.

    Attributes:
        number: The same for the same equations.
        place: Where they are linearised.
        noise: Their weights.
    """

    number: int
    place: Place
    noise: NoiseModel


@dataclass(frozen=True, eq=False)
class FactorKey:
    """Those with the readout weights eliminated.

    Attributes:
        number: The same for the same factor.
        system: Of which.
        damping: Of their diagonal.
    """

    number: int
    system: SystemKey
    damping: float


@dataclass(frozen=True, eq=False)
class PartKey:
    """One record's part of a solution.

    Attributes:
        place: Where it ended.
        noise: That it was found under.
        factor: Of the Hessian.
        schur: (p, p), the Cholesky factor of the parameters' precision, of which all records have their share.
        solution: How it was found; without the point.
        log_evidence: Of all records.
    """

    place: Place
    noise: NoiseModel
    factor: FactorKey
    schur: np.ndarray
    solution: Solution
    log_evidence: float


class Member:
    """One record, and what was computed of it last.

    Args:
        evidence: Of the record.
    """

    def __init__(self, evidence: Evidence) -> None:
        self.evidence = evidence
        self._points: dict[int, Point] = {}
        self._systems: dict[int, BorderedSystem] = {}
        self._eliminated: dict[int, Eliminated | None] = {}

    def point(self, place: Place) -> Point:
        """The point of a place; the very same one of the same place, so that its motion is computed once."""
        like = self.evidence.equations.target.force

        def point() -> Point:
            return Point(*(torch.as_tensor(x).to(like) for x in (place.unknowns, place.parameters)))

        return _kept(self._points, place.number, point, POINTS_KEPT)

    def system(self, key: SystemKey) -> BorderedSystem:
        """Normal equations."""
        return _kept(
            self._systems, key.number, lambda: self.evidence.equations.assemble(self.point(key.place), key.noise)
        )

    def eliminated(self, key: FactorKey) -> Eliminated | None:
        """Those without the readout weights; None if they are singular."""
        return _kept(self._eliminated, key.number, lambda: self.system(key.system).eliminated(key.damping))

    def factor(self, key: FactorKey, schur: np.ndarray) -> BorderedFactor:
        """Of readout and parameters, where other records tell of the parameters too."""
        found = self.eliminated(key)
        assert found is not None
        return BorderedFactor(found.readout, schur)

    def part(self, key: PartKey) -> Trained:
        """The record's own part of a solution."""
        solution = replace(key.solution, point=self.point(key.place))
        return Trained(solution, key.noise, self.factor(key.factor, key.schur), key.log_evidence)


def _kept(store: dict[int, V], number: int, make: Callable[[], V], most: int = 1) -> V:
    """What has that number, made if it is not there; the oldest ones are forgotten."""
    if number not in store:
        made = make()
        while len(store) >= most:
            del store[next(iter(store))]
        store[number] = made
    return store[number]


def losses(member: Member, place: Place, noise: NoiseModel) -> dict[str, float]:
    """See :meth:`pinn_cli.training.band.normal_equations.NormalEquations.losses`."""
    return member.evidence.equations.losses(member.point(place), noise)


def complement(member: Member, key: FactorKey) -> tuple[np.ndarray, float] | None:
    """The Schur complement (p, p), its corner damped, and the readout's log determinant; None if singular."""
    found = member.eliminated(key)
    if found is None:
        return None
    return found.complement, found.readout.log_determinant


def right_hand_side(member: Member, factor: FactorKey, system: SystemKey) -> np.ndarray:
    """(p,), of the parameters, with the readout weights eliminated."""
    return member.factor(factor, np.empty((0, 0))).reduced(member.system(system))[1]


def readout_step(member: Member, factor: FactorKey, system: SystemKey, x: np.ndarray) -> np.ndarray:
    """(size,), the step of the readout weights that goes with one of the parameters."""
    bordered = member.factor(factor, np.empty((0, 0)))
    return bordered.readout_step(bordered.reduced(member.system(system))[0], x)


def readout_alone(member: Member, system: SystemKey) -> np.ndarray | None:
    """(size,), the step of the readout weights with the parameters held; None if it is singular."""
    return member.system(system).readout_step()


def decrease(member: Member, system: SystemKey, weights: np.ndarray, x: np.ndarray) -> float:
    """See :meth:`BorderedSystem.decrease`."""
    return member.system(system).decrease((weights, x))


def record_term(member: Member, place: Place, noise: NoiseModel, readout_log_determinant: float) -> float:
    """See :meth:`Evidence.record_term`."""
    return member.evidence.record_term(member.point(place), noise, readout_log_determinant)


def applied(member: Member, function: Callable[..., Any], part: PartKey, *arguments: Any) -> Any:
    """A function of the record's evidence and of its part of a solution."""
    return function(member.evidence, member.part(part), *arguments)


def occupied(member: Member, part: PartKey) -> float:
    """See :func:`occupied_share`."""
    return occupied_share(member.evidence, member.part(part))
