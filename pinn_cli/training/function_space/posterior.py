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
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.function_space.factor import cholesky
from pinn_cli.training.function_space.kernel import Block, cross_kernel, linearised, prior_variance
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
            what misfit may have added to each (:func:`pinn_cli.training.band.parameter_posterior.coherent_misfit`).
    """

    def __init__(self, search: FunctionSpaceSearch) -> None:
        self.search, self.precision = search, search.precision
        self.columns = search.parameters.uncertain
        self.unit = search.parameters.prior_deviation(search.noise.spread)
        self.noise = search.noise.widened(self._occupied())
        self.linear = Linearisation(search.network, search.parameters, search.rows, self.noise)
        system = self.linear.kernel / self.precision
        system.diagonal().add_(1.0)
        factor = cholesky(system)
        if factor is None:
            raise DivergenceError("gauss_newton diverged: the normal matrix of its solution is singular")
        self.factor = factor
        by_parameter = self.linear.by_parameter
        solved = torch.cholesky_solve(by_parameter, self.factor)
        covariance = torch.linalg.inv(torch.eye(solved.shape[1]).to(solved) + by_parameter.T @ solved)
        self.covariance = covariance + self._coherent_misfit().square().diag()

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
        structure, parameters = self.search.rows.structure, self._values()

        def motion(states: States) -> Tensor:
            return torch.cat((states.displacement.T, states.velocity.T, states.acceleration.T))

        def force(states: States) -> Tensor:
            return structure.external_force(states.displacement, states.velocity, states.acceleration, parameters).T

        network = self.search.network
        moved, _, _ = linearised(network, observation_time[samples], motion)
        acting, _, states = linearised(network, physics_time[samples], force)
        by_parameter = self.search.rows.force_by_parameter(self.columns, states, parameters) * self.unit
        of_motion = self._variance(moved, torch.zeros(moved.size, len(self.columns)).to(by_parameter))
        of_force = self._variance(acting, by_parameter.transpose(0, 1).flatten(0, 1))
        rows = torch.cat((of_motion, of_force)).clamp(min=0.0).sqrt().cpu().numpy()
        every = np.array([np.interp(time, time[samples], row) for row in rows]).reshape(len(QUANTITIES), -1, len(time))
        return Response(time, *(quantity.T for quantity in every))

    def _variance(self, block: Block, by_parameter: Tensor) -> Tensor:
        """(R, P): with the parameters known, and what not knowing them adds."""
        across = torch.cat([cross_kernel(block, known) for known in self.linear.blocks], 1) / self.precision
        half = torch.linalg.solve_triangular(self.factor, across.T, upper=False)
        known = prior_variance(block).flatten() / self.precision - half.square().sum(0)
        explained = torch.linalg.solve_triangular(self.factor, self.linear.by_parameter, upper=False)
        sensitivity = by_parameter - half.T @ explained
        unknown = ((sensitivity @ self.covariance) * sensitivity).sum(1)
        return (known + unknown).view(block.rows, -1)

    def _values(self) -> Mapping[str, Tensor]:
        return {name: value.detach() for name, value in self.search.parameters().items()}
