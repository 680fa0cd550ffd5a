"""State-parameter estimation: the motion of every DOF and the parameters that nobody knows (paper, section 4.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy

from pinn_cli.legal_values import one_of, positive_number
from pinn_cli.record.record import Record
from pinn_cli.scheme.base import Scheme
from pinn_cli.scheme.beliefs import believed_parameters, checked_uncertainty
from pinn_cli.scheme.initial_motion import CHOICES, FREE
from pinn_cli.scheme.missing_values import check_given
from pinn_cli.scheme.problem import THROUGH, Problem, UncertainParameter
from pinn_cli.scheme.sensors import observed_through, sensor_quantities
from pinn_cli.scheme.starting_values import parameter_scales, starting_value
from pinn_cli.scheme.unknowns import POSITIVE, Place, checked_positive, forgetful, initial_values, unknown_places
from pinn_cli.system.chain import Chain


class StateParameter(Scheme):
    """States and unknown parameters from sparse sensors.

    Args:
        unobserved_fraction: See :func:`pinn_cli.scheme.sensors.unobserved_dofs`.
        unobserved: Likewise.
        sensors: What an observed DOF of a simulated record has sensors for.
        unknown: See :func:`pinn_cli.scheme.unknowns.unknown_places`.
        initial: Where unknown parameters start, by kind, name or pattern; those that are not named start at the
            record's own scale (:mod:`pinn_cli.scheme.starting_values`).
        positive: Kinds of parameters that cannot be negative.
        prior_width: Prior standard deviation of an unknown parameter over its scale, which is its initial value or
            that of the record, whichever is larger: wide enough to leave the answer to the record.
        parameter_uncertainty: Relative prior standard deviation of every other parameter but the masses; 0 holds them
            fixed, as the paper does.
        acceleration_through, initial_motion: See :class:`pinn_cli.scheme.problem.Problem`.

    Raises:
        InputError: A setting outside its range.
    """

    name = "state_parameter"

    def __init__(
        self,
        unobserved_fraction: float = 0.4,
        unobserved: str | Sequence[int] | None = (2, 4),
        sensors: Mapping[str, bool] | None = None,
        unknown: str | Sequence[str] | None = None,
        initial: Mapping[str, float | None] | None = None,
        positive: Sequence[str] = POSITIVE,
        prior_width: float = 10.0,
        parameter_uncertainty: float = 0.075,
        acceleration_through: str = "derivative",
        initial_motion: str = FREE,
    ) -> None:
        self.unobserved_fraction, self.unobserved = unobserved_fraction, unobserved
        self.quantities = sensor_quantities({"acceleration": True} if sensors is None else sensors)
        self.unknown, self.initial = unknown, initial
        self.positive = checked_positive(positive)
        self.prior_width = positive_number("scheme.prior_width", prior_width)
        self.parameter_uncertainty = checked_uncertainty(parameter_uncertainty)
        self.acceleration_through = one_of("scheme.acceleration_through", acceleration_through, THROUGH)
        self.initial_motion = one_of("scheme.initial_motion", initial_motion, CHOICES)

    def observe(self, record: Record) -> Record:
        """See :meth:`Scheme.observe`."""
        return observed_through(record, self.quantities, self.unobserved_fraction, self.unobserved)

    def problem(self, prescribed: Chain, record: Record) -> Problem:
        """See :meth:`Scheme.problem`; what was prescribed for an unknown parameter is forgotten."""
        places = unknown_places(prescribed, record, self.unknown)
        check_given(prescribed, places)
        unknown = self._unknown(prescribed, record, places)
        believed = believed_parameters(prescribed, self.parameter_uncertainty, but=places)
        order = {kind: i for i, kind in enumerate(prescribed.parameters)}
        uncertain = sorted((*unknown, *believed), key=lambda p: (order[p.kind], p.dof))
        through, begins = self.acceleration_through, self.initial_motion
        return Problem(forgetful(prescribed, unknown), record, tuple(uncertain), through, initial_motion=begins)

    def posed_again(self, problem: Problem, prescribed: Chain, record: Record) -> Problem:
        """See :meth:`Scheme.posed_again`: by default it is the sensors that say what is unknown."""
        again = copy(self)
        again.unknown = [parameter.name for parameter in problem.uncertain if parameter.unknown]
        return again.problem(prescribed, record)

    def _unknown(self, prescribed: Chain, record: Record, places: Sequence[Place]) -> list[UncertainParameter]:
        given = initial_values(prescribed, self.initial, self.positive)
        scales = parameter_scales(prescribed, record)
        parameters = []
        for kind, dof in places:
            start = given.get((kind, dof), starting_value(kind, scales[kind]))
            scale = max(abs(start), scales[kind])
            parameters.append(
                UncertainParameter(kind, dof, start, self.prior_width * scale, scale, True, kind in self.positive)
            )
        return parameters
