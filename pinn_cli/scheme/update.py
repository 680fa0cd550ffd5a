"""Updating: what earlier records say of the parameters is the prior of the next one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pinn_cli.model.knowledge import Model
from pinn_cli.record.record import Record
from pinn_cli.scheme.joint_problem import MODEL_SETTING, JointProblem
from pinn_cli.scheme.problem import FREE, GAUSSIAN_PROCESS
from pinn_cli.scheme.scheme import Beginning, EstimationScheme, Sensors, Through, UnknownForce
from pinn_cli.settings.errors import InputError
from pinn_cli.system.structure import Structure


class Update(EstimationScheme):
    """The parameters of a finished run, updated with a new record of the same structure.

    Args:
        model: The finished run.
        unobserved_fraction, unobserved, sensors: Of a simulated record, see
            :class:`pinn_cli.scheme.sparse_recovery.SparseRecovery`.
        acceleration_through, initial_motion, unknown_force: See :class:`pinn_cli.scheme.scheme.EstimationScheme`.

    Raises:
        InputError: A setting outside its range, no model, or one that has nothing to update.
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
        acceleration_through: Through = "derivative",
        initial_motion: Beginning = FREE,
        unknown_force: UnknownForce = GAUSSIAN_PROCESS,
    ) -> None:
        self.model = self.given(model)
        if not self.model.parameters:
            hint = "everything in that run was held fixed (scheme.parameter_uncertainty=0)"
            allowed = "a run with uncertain parameters where scheme=update"
            raise InputError(MODEL_SETTING, self.model.directory, allowed, hint)
        chosen = Sensors.chosen(sensors, unobserved_fraction, unobserved)
        super().__init__(chosen, acceleration_through, initial_motion, unknown_force)

    def pose(self, prescribed: Structure, records: Sequence[Record]) -> JointProblem:
        """See :meth:`Scheme.pose`; what is prescribed is the model's."""
        return JointProblem.of_model(self.model, self.only_one(records), True, *self.settings)
