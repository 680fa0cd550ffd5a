"""What is asked of one structure by its records, one or several, that are solved together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.record.record import Record
from pinn_cli.scheme.calibration import sensor_parameters
from pinn_cli.scheme.inputs import inputs_of
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.priors import Prior
from pinn_cli.system.quantities import CALIBRATION_UNITS, OF_ONE_CHANNEL
from pinn_cli.system.structure import Structure


@dataclass(frozen=True, eq=False)
class JointProblem:
    """The problems of all records: one structure, and what is uncertain in two of them is one parameter.

    Attributes:
        by_record: Of every record. Each has its own sensors, length, noise, initial motion and inputs.
        other_starts: The same from other starts of the unknown parameters, for a training that can compare solutions.
        elsewhere: Makes the same from further starts, for where none of those leads to a model that holds.
    """

    by_record: tuple[Problem, ...]
    other_starts: tuple[JointProblem, ...] = ()
    elsewhere: Callable[[], tuple[JointProblem, ...]] = tuple

    @classmethod
    def of(cls, *problems: Problem) -> JointProblem:
        """From one start alone."""
        return cls(problems)

    @classmethod
    def of_records(
        cls,
        structure: Structure,
        records: Sequence[Record],
        uncertain: tuple[Parameter, ...],
        acceleration_through: str,
        initial_motion: str,
        unknown_force: str,
    ) -> JointProblem:
        """Each record has the inputs and the calibrations that its own channels leave open.

        Args:
            structure: See :class:`Problem`.
            records: One or several.
            uncertain: Of the structure.
            acceleration_through: See :class:`Problem`.
            initial_motion: Likewise.
            unknown_force: See :func:`pinn_cli.scheme.inputs.inputs_of`.
        """
        believed: dict[tuple[str, str], Parameter] = {}
        return cls.of(
            *(
                Problem(
                    structure,
                    record,
                    (*uncertain, *(_as_before(p, believed) for p in sensor_parameters(record))),
                    acceleration_through,
                    initial_motion,
                    inputs=inputs_of(structure, record, unknown_force),
                )
                for record in records
            )
        )

    def __iter__(self) -> Iterator[Problem]:
        return iter(self.by_record)

    def __len__(self) -> int:
        """How many records there are."""
        return len(self.by_record)

    @property
    def first(self) -> Problem:
        """That of the first record, which has what all have in common as well."""
        return self.by_record[0]

    @property
    def alone(self) -> Problem:
        """The problem of the only record.

        Raises:
            ValueError: There are several.
        """
        (problem,) = self.by_record
        return problem

    @property
    def starts(self) -> tuple[JointProblem, ...]:
        """The same from every start of the unknown parameters, this one's first."""
        return (JointProblem(self.by_record), *self.other_starts)

    @property
    def structure(self) -> Structure:
        """The prescribed model, of all records."""
        return self.first.structure

    def present(self, values: Mapping[str, np.ndarray]) -> JointProblem:
        """The same with damping of the whole in the modes of some masses and stiffnesses, see `Structure.present`."""
        return JointProblem(tuple(problem.present(values) for problem in self.by_record))

    def reduced_at(self, factors: np.ndarray) -> JointProblem:
        """The same in coordinates that are exact for some factors, see :meth:`Structure.reduced_at`."""
        return self.in_coordinates_of(self.structure.reduced_at(factors))

    def in_coordinates_of(self, structure: Structure) -> JointProblem:
        """The same with its structure in the coordinates that a reduction of its finite-element model has."""
        return self.changed(lambda problem: problem.in_coordinates_of(structure))

    def changed(self, how: Callable[[Problem], Problem]) -> JointProblem:
        """The same with the problem of every record changed, from every start."""

        def all_of(problems: tuple[JointProblem, ...]) -> tuple[JointProblem, ...]:
            return tuple(joint.changed(how) for joint in problems)

        changed = tuple(how(problem) for problem in self.by_record)
        return JointProblem(changed, all_of(self.other_starts), lambda: all_of(self.elsewhere()))

    @property
    def priors(self) -> tuple[Prior, ...]:
        """Of the first record's uncertain parameters, see :attr:`Problem.priors`."""
        return self.first.priors

    @property
    def is_informed(self) -> bool:
        """Whether earlier records say what the parameters are."""
        return self.first.prior is not None

    @property
    def has_unknown_forces(self) -> bool:
        """Whether forces act that nobody measured, in any record."""
        return any(problem.inputs.unmeasured for problem in self.by_record)

    @property
    def identifies(self) -> bool:
        """Whether any parameter is unknown."""
        return any(problem.identifies for problem in self.by_record)


def _as_before(parameter: Parameter, believed: dict[tuple[str, str], Parameter]) -> Parameter:
    """A sensor's parameter as an earlier record has it: a sensor of one name is one sensor.

    An unknown delay's width depends on how a record was sampled, that of offset and drift on what it holds.
    """
    if parameter.kind not in CALIBRATION_UNITS or parameter.kind in OF_ONE_CHANNEL:
        return parameter
    earlier = believed.setdefault((parameter.kind, parameter.label), parameter)
    if parameter.unknown and earlier.unknown:
        return replace(parameter, prior_std=earlier.prior_std)
    if (parameter.prescribed, parameter.prior_std) != (earlier.prescribed, earlier.prior_std):
        said = (
            f"{parameter.prescribed:g} +- {parameter.prior_std:g} and {earlier.prescribed:g} +- {earlier.prior_std:g}"
        )
        hint = "a sensor that was calibrated anew has another name"
        raise InputError("data.channels", f"{parameter.name}: {said}", "the same in all records", hint)
    return parameter
