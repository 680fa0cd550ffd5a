"""What is asked of one structure by its records, one or several, that are solved together."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import starmap
from typing import Any

import numpy as np

from pinn_cli.model.knowledge import Model, ParameterKnowledge
from pinn_cli.record.record import Record
from pinn_cli.scheme.calibration import sensor_parameters
from pinn_cli.scheme.problem import Problem, inputs_of
from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import MASS, Parameter
from pinn_cli.system.priors import Prior
from pinn_cli.system.quantities import CALIBRATION_UNITS, OF_ONE_CHANNEL
from pinn_cli.system.structure import Structure

log = logging.getLogger(__name__)

MODEL_SETTING = "model"


@dataclass(frozen=True, eq=False)
class JointProblem:
    """The problems of all records: one structure, and what is uncertain in two of them is one parameter.

    Attributes:
        by_record: Of every record. Each has its own sensors, length, noise, initial motion and inputs.
        other_starts: The same from other starts of the unknown parameters, for a training that can compare solutions.
        elsewhere: Makes the same from further starts, for where none of those leads to a model that holds.
        compared: So many of the starts are compared even if the model holds from the first of them.
    """

    by_record: tuple[Problem, ...]
    other_starts: tuple[JointProblem, ...] = ()
    elsewhere: Callable[[], tuple[JointProblem, ...]] = tuple
    compared: int = 1

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

        See :class:`Problem` and :func:`pinn_cli.scheme.problem.inputs_of`; ``uncertain`` are of the structure.
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

    @classmethod
    def of_model(
        cls, model: Model, record: Record, updates: bool, acceleration_through: str, initial_motion: str,
        unknown_force: str,
    ) -> JointProblem:  # fmt: skip
        """The problem of a new record of an identified structure, otherwise as :meth:`of_records`.

        ``updates`` says whether the parameters are to be known better afterwards. What the model leaves out then hides
        as much of them in this record as in those before, and bounds cut off what they do of all records' posterior;
        else misfit is one more reason for them to be off, and they are what the earlier run's table says.

        Raises:
            InputError: The run's training did not say how uncertain its parameters are.
        """
        known, count = model.known, len(model.parameters)
        if not np.isfinite(known.covariance).all():
            allowed = "a run whose training gives standard deviations of the parameters, as gauss_newton does"
            raise InputError(MODEL_SETTING, model.directory, allowed)
        mean, covariance = (known.most_probable(model.lower), known.covariance) if updates else model.used
        std = np.sqrt(np.diag(covariance))
        parameters = [
            replace(p, prescribed=float(m), prior_std=float(s), scale=None, unknown=updates and p.unknown)
            for p, m, s in zip(model.parameters, mean, std, strict=True)
        ]
        nothing = np.zeros(count)
        before = known if updates else ParameterKnowledge(mean, covariance, nothing, nothing, std)
        sensors = sensor_parameters(record)
        problem = Problem(
            model.structure.with_values({p: p.prescribed for p in parameters}),
            record,
            (*parameters, *sensors),
            acceleration_through,
            initial_motion,
            inputs=inputs_of(model.structure, record, unknown_force),
            prior=before.with_independent([p.prescribed for p in sensors], [p.prior_std for p in sensors]),
            earlier_levels=model.levels,
        )
        return cls.of(problem)

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
        return self.changed(lambda problem: problem.present(values))

    def in_basis_of(self, structure: Structure) -> JointProblem:
        """The same with its structure in the coordinates and with the functions of laws that another of it has."""
        return self.changed(lambda problem: problem.in_basis_of(structure))

    def changed(self, how: Callable[..., Problem], *by_record: Sequence[Any]) -> JointProblem:
        """The same with the problem of every record changed, from every start; ``by_record`` is what else it takes."""

        def all_of(problems: tuple[JointProblem, ...]) -> tuple[JointProblem, ...]:
            return tuple(joint.changed(how, *by_record) for joint in problems)

        changed = tuple(starmap(how, zip(self.by_record, *by_record, strict=True)))
        return JointProblem(changed, all_of(self.other_starts), lambda: all_of(self.elsewhere()), self.compared)

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
        said = " and ".join(f"{p.prescribed:g} +- {p.prior_std:g}" for p in (parameter, earlier))
        hint = "a sensor that was calibrated anew has another name"
        raise InputError("data.channels", f"{parameter.name}: {said}", "the same in all records", hint)
    return parameter


def unreached_dofs(problem: Problem) -> list[int]:
    """DOFs with a sensor, counted from 0, that no force reaches while one acts elsewhere; they can only swing freely.

    A connection joins its ends if it has a force where it is stretched or moves, or may have: what is unknown. The
    modes of a finite-element model are joined by their shapes.
    """
    from scipy.sparse.csgraph import connected_components

    structure, record = problem.structure, problem.record
    if structure.is_modal:
        return []
    count = structure.incidence.shape[0]
    parameters = structure.parameters_like(np.empty(0))
    force = structure.connection_force(np.ones(count), np.ones(count), parameters)
    joins = np.isnan(force) | (force != 0)
    joins[structure.memory] = True
    for parameter in (p for p in problem.uncertain if p.unknown and p.kind in structure.carriers and p.kind != MASS):
        connections, which = structure.carriers[parameter.kind]
        joins[connections[which == parameter.index]] = True
    stretch = abs(structure.incidence.matrix[joins])
    _, part = connected_components(stretch.T @ stretch, directed=False)
    acting = ~record.unforced
    if record.ground_acceleration is not None:
        acting = acting | (structure.with_ground != 0)
    if structure.by_supports is not None:
        carried = (abs(structure.stretch.matrix[joins]).T @ abs(structure.stretch.matrix[joins]))[:, len(acting) :]
        acting = acting | (carried.sum(axis=1).A1[: len(acting)] > 0.0)
    reached = np.isin(part, part[acting])
    return np.flatnonzero(record.observed & ~reached).tolist() if reached.any() else []


def tell_if_unreached(problem: JointProblem) -> None:
    """Say before anything is solved which sensors no force of the model can move."""
    for number, record_problem in enumerate(problem, start=1):
        dofs = unreached_dofs(record_problem)
        if dofs:
            of = f"record {number}: " if len(problem) > 1 else ""
            text = "%sno force reaches %s, where there is a sensor: no connection joins it to where one acts; add the "
            log.warning(text + "connection, or the force there (data.force)", of, record_problem.record.dof_names(dofs))
