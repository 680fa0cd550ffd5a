"""The Gaussian at the solution: how far parameters and motion are known, from one more linearisation.

In function space the network is a Gaussian process whose kernel is that of its linearisation over the precision of its
weights, seen through residuals of unit variance, with the chain's parameters as regression coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.base import States
from pinn_cli.network.embedding import BAND_MARGIN
from pinn_cli.physics import physics_residual
from pinn_cli.record.evenly_spaced import evenly_spaced
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.record.spectrum import occupied_band
from pinn_cli.training.function_space.kernel import Block, linearised
from pinn_cli.training.function_space.linearisation import Linearisation
from pinn_cli.training.function_space.search import FunctionSpaceSearch

# Times at which standard deviations are computed; between them they change slowly.
TIMES = 96


class FunctionSpacePosterior:
    """Of a training that has ended.

    Args:
        search: At its solution.

    Raises:
        DivergenceError: The normal matrix there is singular.

    Attributes:
        noise: That of the search, its discrepancy widened for its colour: a model error that fills a part of the band
            has fewer independent values, and larger ones, than there are points.
        covariance: (p, p), of the uncertain parameters, in prior standard deviations: the motion integrated out, and
            what misfit may have added to each (:func:`pinn_cli.training.reported.parameter_posterior.coherent_misfit`).
    """

    def __init__(self, search: FunctionSpaceSearch) -> None:
        self.search, self.precision = search, search.precision
        self.columns = search.parameters.uncertain
        self.unit = search.parameters.prior_deviation
        self.noise = search.noise.widened(self._occupied())
        self.linear = Linearisation(search.network, search.parameters, search.rows, self.noise)
        self.system = search.solution.for_bands(self.linear, self.precision, [self._acting()])
        self.covariance = self.system.parameter_covariance + self._coherent_misfit().square().diag()

    def _acting(self) -> Block:
        """The force that the motion takes, on all DOFs, at the points where physics is enforced."""
        return linearised(self.search.network, self.linear.time, self._force)[0]

    def _force(self, states: States) -> Tensor:
        structure = self.search.rows.structure
        return structure.external_force(states.displacement, states.velocity, states.acceleration, self._values()).T

    @torch.no_grad()
    def _occupied(self) -> float:
        """Share of the band that the forces out of balance fill."""
        search, target = self.search, self.search.rows.target
        states = search.network(target.physics_time)
        residual = physics_residual(states, target, search.rows.dynamics, self._values())
        enforced = target.unforced if bool(target.unforced.any()) else target.equation
        step = float(target.physics_time[1] - target.physics_time[0])
        top = min(0.5 / step, BAND_MARGIN * search.network.cycles / search.network.span)
        return occupied_band(residual[:, enforced].cpu().numpy(), step, top)

    @torch.no_grad()
    def _coherent_misfit(self) -> Tensor:
        """(p,), in prior standard deviations, what the model leaves out and each parameter may have taken in."""
        search, target = self.search, self.search.rows.target
        states = search.network(target.physics_time)
        force = search.rows.own_by_parameter(self.columns, states, self._values()) * self.unit
        own = force.square().mean(0).sqrt()
        hidden = self.noise.misfit(1, 1) / own.clamp(min=torch.finfo(own.dtype).tiny)
        return hidden / torch.hypot(torch.ones_like(hidden), hidden)

    def std(self, observation_time: Tensor, physics_time: Tensor, time: np.ndarray) -> Response:
        """Standard deviations of every quantity, (N, n).

        Args:
            observation_time: (N,), when motions are asked for, s.
            physics_time: (N,), when forces are.
            time: (N,), the record's.
        """
        samples = evenly_spaced(len(time), min(TIMES, len(time)))

        def motion(states: States) -> Tensor:
            return torch.cat((states.displacement.T, states.velocity.T, states.acceleration.T))

        network = self.search.network
        moved, _, _ = linearised(network, observation_time[samples], motion)
        acting, _, states = linearised(network, physics_time[samples], self._force)
        by_parameter = self.search.rows.force_by_parameter(self.columns, states, self._values()) * self.unit
        of_motion = self._variance(moved, torch.zeros(moved.size, len(self.columns)).to(by_parameter))
        of_force = self._variance(acting, by_parameter.transpose(0, 1).flatten(0, 1))
        rows = torch.cat((of_motion, of_force)).clamp(min=0.0).sqrt().cpu().numpy()
        every = np.array([np.interp(time, time[samples], row) for row in rows]).reshape(len(QUANTITIES), -1, len(time))
        return Response(time, *(quantity.T for quantity in every))

    def _variance(self, block: Block, by_parameter: Tensor) -> Tensor:
        """(R, P): with the parameters known, and what not knowing them adds."""
        known, following = self.system.explained(block)
        sensitivity = by_parameter - following
        unknown = ((sensitivity @ self.covariance) * sensitivity).sum(1)
        return (known + unknown).view(block.rows, -1)

    def _values(self) -> Mapping[str, Tensor]:
        return {name: value.detach() for name, value in self.search.parameters().items()}
