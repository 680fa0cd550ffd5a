"""What a scheme is: which sensors exist, as a user says it, and which parameters may move."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from pinn_cli.model.knowledge import Model
from pinn_cli.record.channels import motion_amplitudes
from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.scheme.joint_problem import MODEL_SETTING, JointProblem
from pinn_cli.scheme.problem import BEGINNINGS, FREE, THROUGH, UNKNOWN_FORCES
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import entries, is_finite_number, is_whole_number, one_of
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.quantities import FORCE
from pinn_cli.system.structure import Structure

# Settings of schemes with sensors, and what they may be.
Through = Annotated[str, THROUGH]
Beginning = Annotated[str, BEGINNINGS]
UnknownForce = Annotated[str, UNKNOWN_FORCES]


class Scheme(ABC):
    """How an estimation problem is posed. A new one is a file here and a file in ``conf/scheme``.

    Attributes:
        name: What the tables call it.
        looks_for_changes: Whether a record is compared with those before it.
        predicts: Whether there is no response to estimate from.
        has_windows: Whether it has a :meth:`next_problem`.
    """

    name: ClassVar[str]
    looks_for_changes: ClassVar[bool] = False
    predicts: ClassVar[bool] = False
    has_windows: ClassVar[bool] = False

    @abstractmethod
    def observe(self, record: Record) -> Record:
        """The record with the sensors that the scheme allows, of a simulated one in which every DOF has them all.

        Raises:
            InputError: The choice does not fit the record, or leaves no sensor.
        """

    def adapted(self, prescribed: Structure, records: Sequence[Record]) -> Structure:
        """The structure that the observed records are solved with: what its laws count is counted at the motion's size.

        As configured, it is NaN where a measured structure has no value.
        """
        moving = [record for record in records if record.observed.any()]
        if moving and prescribed.state_number.any():
            sizes = [motion_amplitudes(record)["displacement"] for record in moving]
            prescribed = prescribed.moving_by(float(np.median(sizes)))
        return self.damped(prescribed, records)

    def damped(self, prescribed: Structure, records: Sequence[Record]) -> Structure:
        """The structure with damping of its own accord where nobody has said a word of it; else as it is."""
        return prescribed

    @abstractmethod
    def pose(self, prescribed: Structure, records: Sequence[Record]) -> JointProblem:
        """The estimation problem of a prescribed structure and observed records, to be solved together.

        Raises:
            InputError: A setting does not fit, or the scheme has one record at a time.
        """

    def given(self, model: Model | None) -> Model:
        """The model of a scheme that cannot do without.

        Raises:
            InputError: There is none.
        """
        if model is None:
            hint = f"pinn-run model=outputs/... scheme={self.name} data=..."
            raise InputError(MODEL_SETTING, None, f"the directory of a finished run with scheme={self.name}", hint)
        return model

    def only_one(self, records: Sequence[Record], where: str = "", hint: str = "") -> Record:
        """The record of a scheme, or of a setting ``where``, that has one at a time.

        Raises:
            InputError: There are several.
        """
        if len(records) > 1:
            allowed = f"one record with {where or f'scheme={self.name}'}"
            raise InputError("data.records", f"{len(records)} records", allowed, hint)
        return records[0]

    def next_problem(self, model: Model, record: Record) -> JointProblem:
        """The problem of a record that goes on where an earlier one handed over: a window, and the next.

        Its first sample is that at which it was handed over; the model is what is known there, of parameters, motion
        and noise.

        Raises:
            InputError: The scheme has one window at a time.
        """
        hint = "it solves a record as a whole"
        raise InputError("data.window", record.duration, f"null with scheme={self.name}", hint)

    def with_record(self, problem: JointProblem, prescribed: Structure, record: Record) -> JointProblem:
        """The same problem from fewer sensors; what was unknown stays so, and nothing else becomes it."""
        return self.pose(prescribed, [record])


class EstimationScheme(Scheme):
    """A scheme that estimates a motion from sensors, its settings those that all of these have.

    Args:
        sensors: Of a simulated record.
        acceleration_through, initial_motion: See :class:`pinn_cli.scheme.problem.Problem`.
        unknown_force: How a force that nobody measured is estimated: ``gaussian_process`` or ``free``.

    Raises:
        InputError: A setting is none of those that there are.
    """

    def __init__(self, sensors: Sensors, acceleration_through: str, initial_motion: str, unknown_force: str) -> None:
        self.sensors = sensors
        self.acceleration_through = one_of("scheme.acceleration_through", acceleration_through, THROUGH)
        self.initial_motion = one_of("scheme.initial_motion", initial_motion, BEGINNINGS)
        self.unknown_force = one_of("scheme.unknown_force", unknown_force, UNKNOWN_FORCES)

    def observe(self, record: Record) -> Record:
        """See :meth:`Scheme.observe`."""
        return self.sensors.observe(record)

    def next_problem(self, model: Model, record: Record) -> JointProblem:
        """See :meth:`Scheme.next_problem`."""
        problem = JointProblem.of_model(model, record, True, self.acceleration_through, FREE, self.unknown_force)
        return JointProblem.of(replace(problem.alone, initial_state=model.end))

    @property
    def settings(self) -> tuple[str, str, str]:
        """``acceleration_through``, ``initial_motion`` and ``unknown_force``, as problems are made with them."""
        return self.acceleration_through, self.initial_motion, self.unknown_force


def check_given(prescribed: Structure, unknown: Collection[Parameter] = ()) -> None:
    """See that every parameter of a structure has a value, NaN is none, or is unknown.

    Raises:
        InputError: Naming ``system.<kind>`` of what is neither given nor unknown.
    """
    missing: dict[str, list[Parameter]] = {}
    for parameter in prescribed.every_parameter():
        if parameter not in unknown and math.isnan(parameter.prescribed):
            missing.setdefault(parameter.kind, []).append(parameter)
    if not missing:
        return
    all_missing = [parameter for parameters in missing.values() for parameter in parameters]
    settings = ", ".join(dict.fromkeys(prescribed.labels.setting(parameter) for parameter in all_missing))
    units = ", ".join(dict.fromkeys(f"{p.kind} in {p.unit}" for p in all_missing))
    named = bool(prescribed.labels.connections)
    names = ", ".join(_shown([p.name for p in ps], named) for ps in missing.values())
    given = "a number" if named else f"a number or a list of {prescribed.ndof}"
    of_whole = "c" in missing and not prescribed.supports
    whole = "; system.damping={ratio: 0.02} says it of the whole, without a c" if of_whole else ""
    how = f"name them in scheme.unknown of scheme=state_parameter or bayesian{whole}"
    hint = f"a measured record takes no value of the demonstration's. If {names} are unknown, {how}"
    raise InputError(settings, "(nothing)", f"your structure's own, each {given} ({units})", hint)


def _shown(names: list[str], named: bool) -> str:
    """Numbered parameters as a range; those that have names of their own one by one."""
    if named:
        return ", ".join(names)
    return names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}" if len(names) > 2 else ", ".join(names)


PATTERN = re.compile(r"every_(\d+)(?:st|nd|rd|th)")


def unobserved_dofs(ndof: int, fraction: float, unobserved: str | Sequence[int] | None) -> list[int]:
    """DOFs without response sensors, counted from 1.

    Args:
        ndof: Number of DOFs.
        fraction: b_r; without ``unobserved`` the last round(b_r n) DOFs are unobserved (domain extension; paper,
            section 4.1).
        unobserved: A list of DOFs, or ``every_2nd``, ``every_3rd``, ...: every second, third, ... DOF is unobserved
            (interpolation).

    Raises:
        InputError: Any of them outside what is possible, or nothing left to observe.
    """
    if unobserved is None:
        if not is_finite_number(fraction) or not 0 <= fraction < 1:
            raise InputError("scheme.unobserved_fraction", fraction, "a number from 0 to below 1")
        hidden = round(fraction * ndof)
        if hidden == ndof:
            hint = f"{fraction} of {ndof} DOFs rounds to all of them"
            raise InputError("scheme.unobserved_fraction", fraction, "less, so that one DOF stays observed", hint)
        return list(range(ndof - hidden + 1, ndof + 1))
    if isinstance(unobserved, str):
        match = PATTERN.fullmatch(unobserved)
        every = 0 if match is None else int(match[1])
        if every < 2:
            allowed = "null, a list of DOFs, or a pattern such as every_2nd or every_3rd"
            raise InputError("scheme.unobserved", unobserved, allowed)
        dofs = list(range(every, ndof + 1, every))
    else:
        dofs = entries(unobserved)
        if not all(is_whole_number(dof) and 1 <= dof <= ndof for dof in dofs):
            hint = "DOFs are counted from 1 at the fixed end"
            raise InputError("scheme.unobserved", list(unobserved), f"DOFs from 1 to {ndof}", hint)
    if len(set(dofs)) == ndof:
        hint = "an estimator needs one observed DOF"
        raise InputError("scheme.unobserved", unobserved, f"fewer than all {ndof} DOFs", hint)
    return sorted(set(dofs))


@dataclass(frozen=True)
class Sensors:
    """Of a simulated record.

    Attributes:
        quantities: Of the response that every observed DOF has a sensor for.
        load_cells: Whether forced DOFs have one: unless ``force`` is false.
        fraction, unobserved: Which DOFs are not observed, see :func:`unobserved_dofs`.
    """

    quantities: tuple[str, ...]
    load_cells: bool
    fraction: float
    unobserved: str | Sequence[int] | None

    @classmethod
    def chosen(
        cls,
        sensors: Mapping[str, bool] | None,
        fraction: float,
        unobserved: str | Sequence[int] | None,
        default: Sequence[str] = ("acceleration",),
    ) -> Sensors:
        """As a scheme's settings say; of ``default`` quantities where they name none.

        Raises:
            InputError: Naming ``scheme.sensors``: an unknown quantity, or none chosen.
        """
        said = dict.fromkeys(default, True) if sensors is None else sensors
        for name, is_chosen in said.items():
            if name not in (*RESPONSE_QUANTITIES, FORCE) or not isinstance(is_chosen, (bool, np.bool_)):
                allowed = f"true or false for each of {', '.join((*RESPONSE_QUANTITIES, FORCE))}"
                raise InputError(f"scheme.sensors.{name}", is_chosen, allowed)
        quantities = tuple(q for q in RESPONSE_QUANTITIES if said.get(q, False))
        if not quantities:
            allowed = "at least one of displacement, velocity, acceleration set to true"
            raise InputError("scheme.sensors", dict(said), allowed)
        return cls(quantities, bool(said.get(FORCE, True)), fraction, unobserved)

    def observe(self, record: Record) -> Record:
        """See :meth:`pinn_cli.scheme.scheme.Scheme.observe`."""
        hidden = unobserved_dofs(record.ndof, self.fraction, self.unobserved)
        observed = [dof for dof in range(1, record.ndof + 1) if dof not in hidden]
        kept = record.keep(dict.fromkeys(self.quantities, observed))
        return kept if self.load_cells else kept.without_load_cells()
