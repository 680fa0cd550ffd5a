"""Sparse recovery: the motion of every DOF from sensors on some (paper, section 4.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pinn_cli.errors import InputError
from pinn_cli.legal_values import is_finite_number, one_of
from pinn_cli.record.record import Record
from pinn_cli.scheme.base import Scheme
from pinn_cli.scheme.problem import Problem, UncertainParameter
from pinn_cli.scheme.sensors import sensor_quantities, unobserved_dofs
from pinn_cli.system.chain import Chain

THROUGH = ("derivative", "observer", "both")


class SparseRecovery(Scheme):
    """States from sparse sensors and a prescribed model.

    Args:
        unobserved_fraction: See :func:`pinn_cli.scheme.sensors.unobserved_dofs`.
        unobserved: Likewise.
        sensors: What an observed DOF of a simulated record has sensors for.
        parameter_uncertainty: Relative prior standard deviation of every prescribed parameter but the masses; 0 holds
            them fixed, as the paper does.
        acceleration_through: See :class:`pinn_cli.scheme.problem.Problem`.

    Raises:
        InputError: A setting outside its range.
    """

    name = "sparse_recovery"

    def __init__(
        self,
        unobserved_fraction: float = 0.67,
        unobserved: str | Sequence[int] | None = None,
        sensors: Mapping[str, bool] | None = None,
        parameter_uncertainty: float = 0.075,
        acceleration_through: str = "derivative",
    ) -> None:
        self.unobserved_fraction, self.unobserved = unobserved_fraction, unobserved
        self.quantities = sensor_quantities({"acceleration": True} if sensors is None else sensors)
        if not is_finite_number(parameter_uncertainty) or parameter_uncertainty < 0:
            raise InputError(
                "scheme.parameter_uncertainty", parameter_uncertainty, "a number >= 0", "0 holds the parameters fixed"
            )
        self.parameter_uncertainty = float(parameter_uncertainty)
        self.acceleration_through = one_of("scheme.acceleration_through", acceleration_through, THROUGH)

    def observe(self, record: Record) -> Record:
        """See :meth:`Scheme.observe`."""
        hidden = unobserved_dofs(record.ndof, self.unobserved_fraction, self.unobserved)
        observed = [dof for dof in range(1, record.ndof + 1) if dof not in hidden]
        return record.keep(dict.fromkeys(self.quantities, observed))

    def problem(self, prescribed: Chain, record: Record) -> Problem:
        """See :meth:`Scheme.problem`."""
        uncertain = tuple(
            UncertainParameter(kind, dof, float(value), self.parameter_uncertainty * abs(float(value)))
            for kind, values in prescribed.parameters.items()
            for dof, value in enumerate(values)
            if kind != "m" and self.parameter_uncertainty * float(value) != 0
        )
        return Problem(prescribed, record, uncertain, self.acceleration_through)
