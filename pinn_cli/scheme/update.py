"""Updating: what earlier records say of the parameters is the prior of the next one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pinn_cli.model.model import Model
from pinn_cli.record.record import Record
from pinn_cli.scheme.base import Scheme
from pinn_cli.scheme.initial_motion import CHOICES, FREE
from pinn_cli.scheme.inputs import GAUSSIAN_PROCESS, UNKNOWN_FORCES
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.of_model import check_updatable, given, problem_going_on, problem_of_model
from pinn_cli.scheme.problem import THROUGH
from pinn_cli.scheme.sensors import Sensors
from pinn_cli.settings.legal_values import one_of
from pinn_cli.system.structure import Structure


class Update(Scheme):
    """The parameters of a finished run, updated with a new record of the same structure.

    Args:
        model: The finished run.
        unobserved_fraction, unobserved, sensors: Of a simulated record, see
            :class:`pinn_cli.scheme.sparse_recovery.SparseRecovery`.
        acceleration_through, initial_motion: See :class:`pinn_cli.scheme.problem.Problem`.
        unknown_force: How a force that nobody measured is estimated: ``gaussian_process`` or ``free``.

    Raises:
        InputError: A setting outside its range, or no model.
    """

    name = "update"
    has_windows = True
    looks_for_changes = True

    def __init__(
        self,
        model: Model | None,
        unobserved_fraction: float = 0.67,
        unobserved: str | Sequence[int] | None = None,
        sensors: Mapping[str, bool] | None = None,
        acceleration_through: str = "derivative",
        initial_motion: str = FREE,
        unknown_force: str = GAUSSIAN_PROCESS,
    ) -> None:
        self.model = given(model, self.name)
        check_updatable(self.model)
        self.sensors = Sensors.chosen(sensors, unobserved_fraction, unobserved)
        self.acceleration_through = one_of("scheme.acceleration_through", acceleration_through, THROUGH)
        self.initial_motion = one_of("scheme.initial_motion", initial_motion, CHOICES)
        self.unknown_force = one_of("scheme.unknown_force", unknown_force, UNKNOWN_FORCES)

    def observe(self, record: Record) -> Record:
        """See :meth:`Scheme.observe`."""
        return self.sensors.observe(record)

    def pose(self, prescribed: Structure, records: Sequence[Record]) -> JointProblem:
        """See :meth:`Scheme.pose`; what is prescribed is the model's."""
        settings = self.acceleration_through, self.initial_motion, self.unknown_force
        return problem_of_model(self.model, self.only_one(records), True, *settings)

    def next_problem(self, model: Model, record: Record) -> JointProblem:
        """See :meth:`Scheme.next_problem`."""
        return problem_going_on(model, record, self.acceleration_through, self.unknown_force)
