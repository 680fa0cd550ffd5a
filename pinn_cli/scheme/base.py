"""What a scheme is: which sensors exist, and which parameters may move."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from pinn_cli.model.model import Model
from pinn_cli.record.record import Record
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.settings.errors import InputError
from pinn_cli.system.structure import Structure


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

    def damped(self, prescribed: Structure, records: Sequence[Record]) -> Structure:
        """The structure with damping of its own accord where nobody has said a word of it; else as it is.

        Args:
            prescribed: As configured; NaN where a measured structure has no value.
            records: As observed.
        """
        return prescribed

    @abstractmethod
    def pose(self, prescribed: Structure, records: Sequence[Record]) -> JointProblem:
        """The estimation problem of a prescribed structure and observed records, to be solved together.

        Raises:
            InputError: A setting does not fit, or the scheme has one record at a time.
        """

    def only_one(self, records: Sequence[Record], where: str = "", hint: str = "") -> Record:
        """The record of a scheme that has one at a time.

        Args:
            records: Of the run.
            where: The setting that has one at a time, where it is not the scheme as such.
            hint: What else can be done with several.

        Raises:
            InputError: There are several.
        """
        if len(records) > 1:
            allowed = f"one record with {where or f'scheme={self.name}'}"
            raise InputError("data.records", f"{len(records)} records", allowed, hint)
        return records[0]

    def next_problem(self, model: Model, record: Record) -> JointProblem:
        """The problem of a record that goes on where an earlier one handed over: a window, and the next.

        Args:
            model: What is known there, of parameters, motion and noise.
            record: Its first sample is that at which it was handed over.

        Raises:
            InputError: The scheme has one window at a time.
        """
        raise InputError(
            "data.window", record.duration, f"null with scheme={self.name}", "it solves a record as a whole"
        )

    def with_record(self, problem: JointProblem, prescribed: Structure, record: Record) -> JointProblem:
        """The same problem from fewer sensors; what was unknown stays so, and nothing else becomes it.

        Args:
            problem: As it was posed.
            prescribed: See :meth:`pose`.
            record: In place of its own.
        """
        return self.pose(prescribed, [record])
