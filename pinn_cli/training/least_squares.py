"""The weighted least-squares problem of all records that are solved together: what each asks for, the prior once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pinn_cli.runs.side_by_side import side_by_side
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseLevels, NoiseModel
from pinn_cli.training.normal_matrix.bordered import BorderedSystem, SharedSystem
from pinn_cli.training.record_evidence import RecordEvidence

# What changes of a sensor from one record to the next.
OF_ONE_RECORD = ("offset", "drift")


class LeastSquares:
    """The unknowns are the readout weights of all records, one record after the other, and the parameters.

    A parameter that is uncertain in several records is one unknown. The records are computed side by side, perhaps in
    other processes: so their points, systems and factors stay where they are.

    Args:
        records: Of one structure.

    Attributes:
        by_record: The equations of every record.
        members: The records, where they are computed.
        uncertain: The parameters, p of them.
        columns: Of every record, the places of its own parameters among those.
        lower: (p,), bounds in prior standard deviations from the prescribed values; -inf without one.
        scale: (p,), prior standard deviations.
        unknown: (p,) bool: to be identified; the others are believed, and share one spread.
        curve: (p,), of which curve that nobody has a law for it is a term, counted from 0; -1: of none.
        is_plain, is_linear: Whether all records' equations are.
    """

    def __init__(self, records: Sequence[RecordEvidence]) -> None:
        self.by_record = [record.equations for record in records]
        self.uncertain, self.columns = joined_parameters([equations.uncertain for equations in self.by_record])
        self.is_plain = all(equations.is_plain for equations in self.by_record)
        self.is_linear = all(equations.is_linear for equations in self.by_record)
        self.lower = self._gathered([equations.lower for equations in self.by_record])
        self.scale = self._gathered([equations.scale.numpy() for equations in self.by_record])
        self.unknown = self._gathered([equations.unknown.numpy() for equations in self.by_record]).astype(bool)
        self.curve = np.array(self._curves(), dtype=int)
        joint = self.by_record[0].joint_precision
        self._precision = torch.as_tensor(np.eye(len(self.uncertain)) if joint is None else joint)
        # Of every parameter, how many records but the first bring its prior along.
        self._repeated = np.bincount(np.concatenate(self.columns), minlength=len(self.uncertain)) - 1.0
        sizes = [equations.layout.size for equations in self.by_record]
        self._ends = np.cumsum(sizes)[:-1].tolist()
        self.members = side_by_side(records, sizes)
        self._placed: tuple[Point | None, list[Any]] = None, []

    def _curves(self) -> list[int]:
        """See :attr:`curve`; what earlier records say of a term stands for itself."""
        told = self.by_record[0].problem.prior is not None
        of = [p.curve if p.unknown and not told else "" for p in self.uncertain]
        names = list(dict.fromkeys(filter(None, of)))
        return [names.index(name) if name else -1 for name in of]

    def roughness(self, noise: NoiseLevels) -> np.ndarray:
        """(curves,), see :attr:`NoiseLevels.roughness`: ones before any was found."""
        return noise.roughness if len(noise.roughness) else np.ones(self.curve.max(initial=-1) + 1)

    def _gathered(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """(p,) from what every record has for its own parameters; all must have the same for the same one.

        Raises:
            ValueError: They have not.
        """
        out = np.full(len(self.uncertain), np.nan)
        for columns, record_values in zip(self.columns, values, strict=True):
            out[columns] = record_values
        for columns, record_values in zip(self.columns, values, strict=True):
            if not np.array_equal(out[columns], record_values):
                raise ValueError("records that are solved together must believe the same of their common parameters")
        return out

    def start(self) -> Point:
        """At rest, with the prescribed parameters, or with those that are known."""
        return self.joined([equations.start() for equations in self.by_record])

    def split(self, point: Point) -> list[Point]:
        """The point of every record."""
        unknowns = torch.tensor_split(point.unknowns, self._ends)
        return [Point(w, point.parameters[columns]) for w, columns in zip(unknowns, self.columns, strict=True)]

    def joined(self, points: Sequence[Point]) -> Point:
        """The point of all records from those of each."""
        parameters = points[0].parameters.new_zeros(len(self.uncertain))
        for columns, record_point in zip(self.columns, points, strict=True):
            parameters[columns] = record_point.parameters
        return Point(torch.cat([record_point.unknowns for record_point in points]), parameters)

    def placed(self, point: Point) -> list[Any]:
        """The point of every record, where the record is: the very same for the same point, which is computed once."""
        if self._placed[0] is not point:
            arrays = zip(*(record_point.arrays for record_point in self.split(point)), strict=True)
            self._placed = point, self.members.keep(placed, self.members.held, *arrays)
        return self._placed[1]

    def share_ridges(self, other: LeastSquares) -> None:
        """Have the prior of other equations of the same functions, which hangs on their first weights."""
        self.members.each(_share_ridge, other.members.each(attrgetter("equations.ridge.value")))

    def room_below(self, point: Point) -> np.ndarray:
        """(p,), the most negative step of every parameter that respects its bound; -inf without one."""
        room: np.ndarray = self.lower - point.parameters.numpy()
        return np.minimum(room, 0.0)

    def moved(self, point: Point, step: tuple[np.ndarray, np.ndarray]) -> Point:
        """The point after a step of the readout weights (size,) and of the parameters (p,).

        A parameter that the step takes to its bound is at the bound, whatever the rounding.
        """
        unknowns, parameters = (torch.as_tensor(x).to(point.unknowns) for x in step)
        lower = torch.as_tensor(self.lower).to(point.unknowns)
        held = torch.as_tensor(step[1] <= self.room_below(point))
        after = point.moved((unknowns, parameters))
        return Point(after.unknowns, torch.where(held, lower, torch.maximum(after.parameters, lower)))

    def retries(self, start: Point, refused: Point, noise: NoiseLevels) -> Iterator[Point]:
        """See :meth:`pinn_cli.training.minimise.Equations.retries`."""
        yield self.followed(refused, noise)

    def followed(self, point: Point, noise: NoiseLevels) -> Point:
        """The point whose motion has made a step of its own, parameters held.

        Where physics is stiff, a step of motion and parameters together leaves the narrow valley of what solves it by
        the product of both changes. The motion is (nearly) linear given the parameters: one step brings it back
        (variable projection; Golub and Pereyra 1973).
        """
        if not len(point.parameters):
            return point
        step = self.assemble(point, noise).readout_step()
        return point if step is None else self.moved(point, (step, np.zeros(len(point.parameters))))

    def losses(self, point: Point, noise: NoiseLevels) -> dict[str, float]:
        """Weighted sum of squares of every residual and of the ridge, over all records, and of the prior once."""
        total: dict[str, float] = {}
        for record_losses in self.members.each(_losses, self.placed(point), noise.records, self.priors(noise)):
            for name, value in record_losses.items():
                total[name] = total.get(name, 0.0) + value
        x = point.parameters
        return total | {"prior": float((x * (self.prior_precision(noise) @ x)).sum())}

    def precision(self, noise: NoiseLevels) -> Tensor:
        """(p,), prior precision of every parameter by itself: believed ones share one spread."""
        out = np.where(self.unknown, 1.0 + noise.firmness**2, noise.spread**-2)
        terms = self.curve >= 0
        out[terms] += self.roughness(noise)[self.curve[terms]] ** -2 - 1.0
        return torch.as_tensor(out)

    def prior_precision(self, noise: NoiseLevels) -> Tensor:
        """(p, p), of all parameters together; earlier records may have told of them."""
        alone = self.precision(noise)
        return self._precision * torch.outer(alone, alone).sqrt()

    def priors(self, noise: NoiseLevels) -> list[np.ndarray]:
        """Of every record's parameters, (p, p)."""
        whole = self.prior_precision(noise).numpy()
        return [whole[np.ix_(columns, columns)] for columns in self.columns]

    def assemble(self, point: Point, noise: NoiseLevels) -> SharedSystem:
        """Normal equations at a point."""
        at = self.members.held, self.placed(point)
        systems = self.members.keep(_assembled, *at, noise.records, self.priors(noise))
        repeated, known_parameters = self._repeated * self.precision(noise).numpy(), self.by_record[0].known_parameters
        held = None if known_parameters is None else known_parameters.covariance
        pull = repeated * point.parameters.numpy()
        return SharedSystem(self.members, self.columns, systems, repeated, pull, held, noise.held)


def joined_parameters(parameters: Sequence[Sequence[Parameter]]) -> tuple[tuple[Parameter, ...], list[np.ndarray]]:
    """All parameters of several records, those of the first one first, and of every record the places of its own.

    A parameter of the structure is the same in all records. So are the gain and the delay of a sensor of one name.
    Offset and drift of a sensor are another record's own: they have the number of the record in their name there.
    """
    place: dict[tuple[str, str | int, int | None], int] = {}
    joint: list[Parameter] = []
    columns = []
    for number, record_parameters in enumerate(parameters, start=1):
        places = []
        for parameter in record_parameters:
            of_record = parameter.kind in OF_ONE_RECORD
            which = parameter.label if parameter.kind in CALIBRATION_UNITS else parameter.index
            key = parameter.kind, which, number if of_record else None
            if key not in place:
                place[key] = len(joint)
                renamed = replace(parameter, label=f"{parameter.label}_record_{number}")
                joint.append(renamed if of_record and number > 1 else parameter)
            places.append(place[key])
        columns.append(np.array(places, dtype=int))
    return tuple(joint), columns


def placed(record: RecordEvidence, unknowns: np.ndarray, parameters: np.ndarray) -> Point:
    """A point of a record from its :attr:`Point.arrays`, where the record is."""
    like = record.equations.target.force
    return Point(*(torch.as_tensor(x).to(like) for x in (unknowns, parameters)))


def _share_ridge(evidence: RecordEvidence, ridge: float | np.ndarray | None) -> None:
    evidence.equations.ridge.value = ridge


def _losses(record: RecordEvidence, point: Point, noise: NoiseModel, prior: np.ndarray) -> dict[str, float]:
    return record.equations.losses(point, noise, prior)


def _assembled(record: RecordEvidence, point: Point, noise: NoiseModel, prior: np.ndarray) -> BorderedSystem:
    return record.equations.assemble(point, noise, prior)
