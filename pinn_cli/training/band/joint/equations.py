"""Normal equations of several records whose parameters are the same: each a band, and one border for all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
import torch
from torch import Tensor

from pinn_cli.runs.side_by_side import Items
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.training.band.bordered import BorderedFactor
from pinn_cli.training.band.elimination import Elimination
from pinn_cli.training.band.joint import member
from pinn_cli.training.band.joint.member import FactorKey, Member, Place, SystemKey
from pinn_cli.training.band.normal_equations import NormalEquations
from pinn_cli.training.band.point import Bounded, Point
from pinn_cli.training.noise_model import NoiseModel

# What changes of a sensor from one record to the next.
OF_ONE_RECORD = ("offset", "drift")


class JointEquations(Bounded):
    """The weighted least-squares problem of several records of one structure.

    The unknowns are the readout weights of all records, one record after the other, and the parameters. A parameter
    that is uncertain in several records is one unknown; its prior counts once.

    Args:
        each: The equations of every record.
        members: Where their parts are computed, in the same order.

    Attributes:
        uncertain: The parameters, p of them.
        columns: Of every record, the places of its own parameters among those.
        lower: See :class:`Bounded`.
        scale: (p,), prior standard deviations.
        unknown: (p,) bool.
        ends: Where every record's readout weights end.
        keeps_factors: Members keep one factor alone.
    """

    keeps_factors = False

    def __init__(self, each: Sequence[NormalEquations], members: Items[Member]) -> None:
        self.each, self.members = tuple(each), members
        self.uncertain, self.columns = joined_parameters([own.uncertain for own in self.each])
        self.is_plain = all(own.is_plain for own in self.each)
        self.is_linear = False
        self.lower = self.gathered([own.lower for own in self.each])
        self.scale = torch.as_tensor(self.gathered([own.scale.cpu().numpy() for own in self.each]))
        self.unknown = torch.as_tensor(self.gathered([own.unknown.cpu().numpy() for own in self.each])).bool()
        # Of every parameter, how many records but the first bring its prior along.
        self.repeated = np.bincount(np.concatenate(self.columns), minlength=len(self.uncertain)) - 1.0
        self.ends = np.cumsum([own.layout.size for own in self.each])
        self._numbers = count()
        self._numbered: tuple[Point | None, int] = (None, 0)

    def gathered(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """(p,) from what every record has for its own parameters; all must have the same for the same one.

        Raises:
            ValueError: They have not.
        """
        out = np.full(len(self.uncertain), np.nan)
        for columns, own in zip(self.columns, values, strict=True):
            out[columns] = own
        for columns, own in zip(self.columns, values, strict=True):
            if not np.array_equal(out[columns], own):
                raise ValueError("records that are solved together must believe the same of their common parameters")
        return out

    def number(self) -> int:
        """A new one."""
        return next(self._numbers)

    def start(self) -> Point:
        """At rest, with the prescribed parameters."""
        zeros = self.each[0].target.force.new_zeros
        return Point(zeros(int(self.ends[-1])), zeros(len(self.uncertain)))

    def split(self, point: Point) -> list[Point]:
        """The point of every record."""
        unknowns = torch.tensor_split(point.unknowns, self.ends[:-1].tolist())
        return [Point(w, point.parameters[columns]) for w, columns in zip(unknowns, self.columns, strict=True)]

    def joined(self, points: Sequence[Point]) -> Point:
        """The point of all records from those of each."""
        parameters = points[0].parameters.new_zeros(len(self.uncertain))
        for columns, own in zip(self.columns, points, strict=True):
            parameters[columns] = own.parameters
        return Point(torch.cat([own.unknowns for own in points]), parameters)

    def places(self, point: Point) -> list[Place]:
        """The same for the members."""
        if self._numbered[0] is not point:
            self._numbered = point, self.number()
        number = self._numbered[1]
        return [Place(number, own.unknowns.cpu().numpy(), own.parameters.cpu().numpy()) for own in self.split(point)]

    def losses(self, point: Point, noise: NoiseModel) -> dict[str, float]:
        """Weighted sum of squares of every residual, over all records, of the parameters' prior and of the ridge."""
        total: dict[str, float] = {}
        for own in self.members.each(member.losses, self.places(point), noise.by_record):
            for name, value in own.items():
                total[name] = total.get(name, 0.0) + value
        return total | {"prior": float((self.precision(noise) * point.parameters.cpu().square()).sum())}

    def precision(self, noise: NoiseModel) -> Tensor:
        """(p,), prior precision of the parameters, in their units."""
        return torch.where(self.unknown, 1.0, noise.spread**-2)

    def assemble(self, point: Point, noise: NoiseModel) -> JointSystem:
        """Normal equations at a point."""
        number = self.number()
        levels = zip(self.places(point), noise.by_record, strict=True)
        return JointSystem(self, point, noise, [SystemKey(number, *each) for each in levels])


def joined_parameters(each: Sequence[Sequence[Parameter]]) -> tuple[tuple[Parameter, ...], list[np.ndarray]]:
    """All parameters of several records, those of the first one first, and of every record the places of its own.

    A parameter of the structure is the same in all records. So are the gain and the delay of a sensor of one name.
    Offset and drift of a sensor are another record's own: they have the number of the record in their name there.
    """
    place: dict[tuple[object, ...], int] = {}
    every: list[Parameter] = []
    columns = []
    for number, own in enumerate(each, start=1):
        places = []
        for parameter in own:
            of_record = parameter.kind in OF_ONE_RECORD
            key: tuple[object, ...] = (
                parameter.kind,
                parameter.label if parameter.kind in CALIBRATION_UNITS else parameter.index,
            )
            key = (*key, number) if of_record else key
            if key not in place:
                place[key] = len(every)
                renamed = replace(parameter, label=f"{parameter.label}_record_{number}")
                every.append(renamed if of_record and number > 1 else parameter)
            places.append(place[key])
        columns.append(np.array(places, dtype=int))
    return tuple(every), columns


@dataclass(frozen=True, eq=False)
class JointSystem:
    """Normal equations of several records, which stay with the members.

    Attributes:
        equations: Whose.
        point: Where they are linearised.
        noise: Their weights.
        keys: Of every record's.
    """

    equations: JointEquations
    point: Point
    noise: NoiseModel
    keys: list[SystemKey]

    def factor(self, damping: float = 0.0) -> JointFactor | None:
        """With all readout weights eliminated and the Schur complements summed; None if not positive definite."""
        equations = self.equations
        number = equations.number()
        keys = [FactorKey(number, system, damping) for system in self.keys]
        total, determinants = np.zeros((len(equations.uncertain),) * 2), []
        for columns, found in zip(equations.columns, equations.members.each(member.complement, keys), strict=True):
            if found is None:
                return None
            total[np.ix_(columns, columns)] += found[0]
            determinants.append(found[1])
        total[np.diag_indices_from(total)] -= (1.0 + damping) * self._repeated_prior
        try:
            schur = np.linalg.cholesky((total + total.T) / 2.0)
        except np.linalg.LinAlgError:
            return None
        nothing = Elimination.of_nothing(len(total))
        return JointFactor(nothing, schur, equations, keys, determinants)

    def readout_step(self) -> np.ndarray | None:
        """See :meth:`BorderedSystem.readout_step`, of all records."""
        steps = self.equations.members.each(member.readout_alone, self.keys)
        found = [step for step in steps if step is not None]
        return np.concatenate(found) if len(found) == len(steps) else None

    def decrease(self, step: tuple[np.ndarray, np.ndarray]) -> float:
        """See :meth:`BorderedSystem.decrease`, of all records."""
        equations = self.equations
        of_records = np.split(step[0], equations.ends[:-1]), [step[1][columns] for columns in equations.columns]
        total = sum(equations.members.each(member.decrease, self.keys, *of_records))
        return total + float((self._repeated_prior * self.point.parameters.cpu().numpy()) @ step[1])

    @property
    def _repeated_prior(self) -> np.ndarray:
        return self.equations.repeated * self.equations.precision(self.noise).numpy()

    def right_hand_side(self, keys: Sequence[FactorKey]) -> np.ndarray:
        """(p,), of the parameters, with all readout weights eliminated."""
        equations = self.equations
        out = self._repeated_prior * self.point.parameters.cpu().numpy()
        every = equations.members.each(member.right_hand_side, keys, self.keys)
        for columns, own in zip(equations.columns, every, strict=True):
            out[columns] += own
        return out


@dataclass(frozen=True, eq=False)
class JointFactor(BorderedFactor):
    """The factor of the parameters' part, with all readout weights eliminated; those of the readout stay away.

    Attributes:
        equations: Whose.
        keys: Of every record's factor.
        determinants: Logarithms of the determinants of every record's A.
    """

    equations: JointEquations
    keys: list[FactorKey]
    determinants: list[float]

    def step(  # type: ignore[override]
        self, system: JointSystem, lower: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solution (w, x) of all records' equations, as of :meth:`BorderedFactor.step`."""
        x = self.of_parameters(system.right_hand_side(self.keys), lower)
        own = [x[columns] for columns in self.equations.columns]
        steps = self.equations.members.each(member.readout_step, self.keys, system.keys, own)
        return np.concatenate(steps), x

    @property
    def readout_log_determinant(self) -> float:
        """Over all records."""
        return sum(self.determinants)

    def of_record(self, record: int) -> np.ndarray:
        """Cholesky factor of the precision of one record's parameters, the others integrated out."""
        columns = self.equations.columns[record]
        if np.array_equal(columns, np.arange(len(self.schur))):
            return self.schur
        return np.linalg.cholesky(np.linalg.inv(self.corner_covariance[np.ix_(columns, columns)]))
