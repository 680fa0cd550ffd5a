"""Sparse recovery: the motion of every DOF from sensors on some (paper, section 4.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pinn_cli.model.knowledge import Model
from pinn_cli.record.record import Record
from pinn_cli.scheme.calibration import sensor_parameters
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import FREE, GAUSSIAN_PROCESS
from pinn_cli.scheme.scheme import Beginning, EstimationScheme, Sensors, Through, UnknownForce, check_given
from pinn_cli.scheme.starts import Starts, calibrated
from pinn_cli.scheme.unknowns import believed_parameters, checked_uncertainty
from pinn_cli.system.structure import Structure


class SparseRecovery(EstimationScheme):
    """States from sparse sensors and a prescribed model.

    Args:
        unobserved_fraction, unobserved: See :func:`pinn_cli.scheme.scheme.unobserved_dofs`.
        sensors: What an observed DOF of a simulated record has sensors for.
        parameter_uncertainty: Relative prior standard deviation of every prescribed parameter but the masses; 0 holds
            them fixed, as the paper does.
        acceleration_through, initial_motion, unknown_force: See :class:`pinn_cli.scheme.scheme.EstimationScheme`.
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
        acceleration_through: Through = "derivative",
        initial_motion: Beginning = FREE,
        unknown_force: UnknownForce = GAUSSIAN_PROCESS,
        model: Model | None = None,
    ) -> None:
        chosen = Sensors.chosen(sensors, unobserved_fraction, unobserved)
        super().__init__(chosen, acceleration_through, initial_motion, unknown_force)
        self.model = model
        self.parameter_uncertainty = checked_uncertainty(parameter_uncertainty)

    def pose(self, prescribed: Structure, records: Sequence[Record]) -> JointProblem:
        """See :meth:`Scheme.pose`."""
        if self.model is not None:
            hint = "one run after the other: each is the model of the next with scheme=update"
            (record,) = _calibrated(self.model.structure, [self.only_one(records, "model=...", hint)])
            return JointProblem.of_model(self.model, record, False, *self.settings)
        check_given(prescribed)
        uncertain = believed_parameters(prescribed, self.parameter_uncertainty)
        return JointProblem.of_records(prescribed, _calibrated(prescribed, records), uncertain, *self.settings)


def _calibrated(prescribed: Structure, records: Sequence[Record]) -> list[Record]:
    """The records whose sensors' unknown gains and delays start where they fit the prescribed structure."""
    if not any(parameter.unknown for record in records for parameter in sensor_parameters(record)):
        return list(records)
    (starts,) = Starts(prescribed, records, (), {}, most=1)
    return calibrated(records, starts)
