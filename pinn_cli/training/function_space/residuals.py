"""All residuals of a network as rows of one vector, each over its standard deviation.

A row is one kind of residual of one DOF at all P points: R rows, R P residuals, row after row. The rows of observations
look at the motion when the sensors were read, the others at the points where physics is enforced.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from pinn_cli.network.base import States
from pinn_cli.physics import Targets, observation_masks, observation_residuals, physics_residual
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.structure import Structure
from pinn_cli.training.noise_model import NoiseModel


@dataclass(frozen=True, eq=False)
class ResidualRows:
    """Which residuals there are, and what they are divided by.

    Attributes:
        dynamics: Equations of the prescribed model.
        target: What the motion is compared with, at P points.
        through: Of the accelerations, see :class:`pinn_cli.scheme.problem.Problem`.
        separate: Whether velocity is an output of its own, so that continuity is a residual too.
        deviation: Prior standard deviations of displacement (m) and velocity (m/s) where the motion begins; None where
            nothing is known about them.
    """

    dynamics: Dynamics
    target: Targets
    through: str
    separate: bool
    deviation: tuple[float, float] | None = None

    @property
    def structure(self) -> Structure:
        """The prescribed model."""
        return self.dynamics.structure

    def observed(self, states: States, parameters: Mapping[str, Tensor], noise: NoiseModel) -> Tensor:
        """Estimated minus measured response over its noise, (R_o, P)."""
        residuals = observation_residuals(states, self.target, self.dynamics, parameters, self.through)
        mass = self.structure.parameters["m"].detach().cpu().numpy()
        rows = []
        for name, mask in observation_masks(self.target, self.through).items():
            weight = torch.as_tensor(noise.observation_weight(name, mass)).to(states.displacement)
            rows.append((residuals[name] * weight.sqrt())[..., mask].T)
        return torch.cat(rows)

    def enforced(self, states: States, parameters: Mapping[str, Tensor], noise: NoiseModel) -> Tensor:
        """Forces out of balance over what model and load cells leave open, then continuity, (R_p, P)."""
        std = torch.as_tensor(noise.physics_variance).to(states.displacement).sqrt()
        force = physics_residual(states, self.target, self.dynamics, parameters) / std
        rows = [force[..., self.target.equation].T]
        if states.continuity is not None:
            rows.append(states.continuity.T / noise.continuity)
        return torch.cat(rows)

    def initial(self, states: States) -> Tensor:
        """Displacement, then velocity, of every DOF at one time over their prior deviations, (2 n, 1)."""
        assert self.deviation is not None
        displacement, velocity = self.deviation
        return torch.cat((states.displacement / displacement, states.velocity / velocity), -1).mT

    @property
    def observed_count(self) -> int:
        """R_o."""
        return sum(int(mask.sum()) for mask in observation_masks(self.target, self.through).values())

    @property
    def force_count(self) -> int:
        """How many of the enforced rows are equations of motion; the others are continuity."""
        return int(self.target.equation.sum())

    @property
    def enforced_count(self) -> int:
        """R_p."""
        return self.force_count + (len(self.target.equation) if self.separate else 0)

    @property
    def points(self) -> int:
        """P."""
        return len(self.target.physics_time)

    def by_parameter(
        self, columns: Sequence[Parameter], observed: States, enforced: States,
        parameters: Mapping[str, Tensor], noise: NoiseModel,
    ) -> Tensor:  # fmt: skip
        """Derivatives of the observed and enforced rows by parameters of the structure, (R P, p)."""
        out = observed.displacement.new_zeros(self.observed_count + self.enforced_count, self.points, len(columns))
        equation = self.target.equation
        std = torch.as_tensor(noise.physics_variance).to(out).sqrt()
        force = self.force_by_parameter(columns, enforced, parameters) / std[:, None]
        first = self.observed_count
        out[first : first + self.force_count] = force[:, equation].transpose(0, 1)
        masks = observation_masks(self.target, self.through)
        if "observer" in masks:
            mass = self.structure.parameters["m"].detach()
            weight = torch.as_tensor(noise.observation_weight("observer", mass.cpu().numpy())).to(out).sqrt()
            # The observer equation is (f - r) / m: the force that the motion takes, but for m times acceleration.
            motion = observed._replace(acceleration=self._observer(observed, parameters))
            rows = -self.force_by_parameter(columns, motion, parameters) * (weight / parameters["m"])[:, None]
            before = sum(int(mask.sum()) for name, mask in masks.items() if name != "observer")
            out[before:first] = rows[:, masks["observer"]].transpose(0, 1)
        return out.flatten(0, 1)

    def _observer(self, states: States, parameters: Mapping[str, Tensor]) -> Tensor:
        return self.structure.acceleration(states.displacement, states.velocity, self.target.observer_force, parameters)

    def force_by_parameter(
        self, columns: Sequence[Parameter], states: States, parameters: Mapping[str, Tensor]
    ) -> Tensor:
        """(P, n, p), of the force that the motion takes: m a + B' r."""
        linear = self.structure.linearise(states.displacement, states.velocity, parameters)
        return self.structure.by_parameters(linear, columns, states.acceleration)

    def own_by_parameter(
        self, columns: Sequence[Parameter], states: States, parameters: Mapping[str, Tensor]
    ) -> Tensor:
        """(P, p), what each parameter does to its own connection or mass."""
        linear = self.structure.linearise(states.displacement, states.velocity, parameters)
        return linear.by_parameters(columns, states.acceleration)
