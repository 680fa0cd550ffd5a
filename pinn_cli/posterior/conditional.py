"""The posterior of the parameters as the paper samples it, given the motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.posterior.marginal import Marginal
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.training.reported.parameter_likelihoods import ParameterLikelihood, ParameterLikelihoods


class Conditional(Marginal):
    """NUTS on the likelihood with the states locked at those of the trained network: the paper's scheme.

    It takes the estimated motion for the true one, so it is overconfident: its standard deviations were 2 to 14 times
    too small, and its 90 % intervals covered the truth in 36 to 50 % of all cases over 40 noise seeds. It is here to
    be compared with; :class:`Marginal` is the one to use.

    Settings: see :class:`Marginal`.
    """

    name = "conditional"

    def likelihood(self, likelihoods: ParameterLikelihoods) -> ParameterLikelihood:
        """That with the network's states held as they were trained."""
        return likelihoods.conditional

    def check(self, problem: Problem) -> None:
        """See :meth:`Posterior.check`: the force that a held motion takes says nothing about a sensor.

        Nor does it of modes, to whose equations a force on a DOF is common.
        """
        if problem.structure.is_modal:
            hint = "a measured force is common to all modes"
            raise InputError("posterior", self.name, "marginal or laplace with system=matrices", hint)
        if problem.record.calibrated:
            allowed = "marginal or laplace where samples are missing or a sensor is in doubt"
            raise InputError("posterior", self.name, allowed, f"channel {problem.record.calibrated[0].key} is such")
