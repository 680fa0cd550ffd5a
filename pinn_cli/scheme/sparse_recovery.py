"""Sparse recovery: the motion of every DOF from sensors on some (paper, section 4.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pinn_cli.model.model import Model
from pinn_cli.record.record import Record
from pinn_cli.scheme.base import Scheme
from pinn_cli.scheme.beliefs import believed_parameters, checked_uncertainty
from pinn_cli.scheme.calibration import calibrated_starts, sensor_parameters
from pinn_cli.scheme.initial_motion import CHOICES, FREE
from pinn_cli.scheme.inputs import GAUSSIAN_PROCESS, UNKNOWN_FORCES
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.missing_values import check_given
from pinn_cli.scheme.of_model import problem_going_on, problem_of_model
from pinn_cli.scheme.problem import THROUGH
from pinn_cli.scheme.sensors import Sensors
from pinn_cli.scheme.starts import parameter_starts
from pinn_cli.settings.legal_values import one_of
from pinn_cli.system.structure import Structure


class SparseRecovery(Scheme):
    """States from sparse sensors and a prescribed model.

    Args:
        unobserved_fraction: See :func:`pinn_cli.scheme.sensors.unobserved_dofs`.
        unobserved: Likewise.
        sensors: What an observed DOF of a simulated record has sensors for.
        parameter_uncertainty: Relative prior standard deviation of every prescribed parameter but the masses; 0 holds
            them fixed, as the paper does.
        acceleration_through, initial_motion: See :class:`pinn_cli.scheme.problem.Problem`.
        unknown_force: How a force that nobody measured is estimated: ``gaussian_process`` or ``free``.
        model: A finished run whose structure and parameters are taken instead of prescribed ones; None: there is none.

    Raises:
        InputError: A setting outside its range.
    """

    name = "sparse_recovery"
    has_windows = True

    def __init__(
        self,
        unobserved_fraction: float = 0.67,
        unobserved: str | Sequence[int] | None = None,
        sensors: Mapping[str, bool] | None = None,
        parameter_uncertainty: float = 0.075,
        acceleration_through: str = "derivative",
        initial_motion: str = FREE,
        unknown_force: str = GAUSSIAN_PROCESS,
        model: Model | None = None,
    ) -> None:
        self.model = model
        self.sensors = Sensors.chosen(sensors, unobserved_fraction, unobserved)
        self.parameter_uncertainty = checked_uncertainty(parameter_uncertainty)
        self.acceleration_through = one_of("scheme.acceleration_through", acceleration_through, THROUGH)
        self.initial_motion = one_of("scheme.initial_motion", initial_motion, CHOICES)
        self.unknown_force = one_of("scheme.unknown_force", unknown_force, UNKNOWN_FORCES)

    def observe(self, record: Record) -> Record:
        """See :meth:`Scheme.observe`."""
        return self.sensors.observe(record)

    def pose(self, prescribed: Structure, records: Sequence[Record]) -> JointProblem:
        """See :meth:`Scheme.pose`."""
        through, begins = self.acceleration_through, self.initial_motion
        if self.model is not None:
            hint = "one run after the other: each is the model of the next with scheme=update"
            (record,) = _calibrated(self.model.structure, [self.only_one(records, "model=...", hint)])
            return problem_of_model(self.model, record, False, through, begins, self.unknown_force)
        check_given(prescribed)
        uncertain = believed_parameters(prescribed, self.parameter_uncertainty)
        calibrated = _calibrated(prescribed, records)
        return JointProblem.of_records(prescribed, calibrated, uncertain, through, begins, self.unknown_force)

    def next_problem(self, model: Model, record: Record) -> JointProblem:
        """See :meth:`Scheme.next_problem`."""
        return problem_going_on(model, record, self.acceleration_through, self.unknown_force)


def _calibrated(prescribed: Structure, records: Sequence[Record]) -> list[Record]:
    """The records whose sensors' unknown gains and delays start where they fit the prescribed structure."""
    record, *further = records
    if not any(parameter.unknown for each in records for parameter in sensor_parameters(each)):
        return list(records)
    (starts,) = parameter_starts(prescribed, record, (), {}, most=1, further=further)
    values = {parameter: start.value for parameter, start in starts.items()}
    return [calibrated_starts(each, values) for each in records]
