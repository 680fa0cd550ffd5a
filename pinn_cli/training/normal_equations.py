"""Residuals of a linear-readout network on a chain, and their Gauss-Newton normal equations as a band with a border.

A residual of DOF i at one time touches the features alive there, of DOFs i-1, i, i+1, and the parameters of connections
i and i+1. So its Jacobian is a short dense row [J | P], and all of a group's rows together give one small dense block.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.base import States
from pinn_cli.network.linear_readout import LinearReadout, Segments
from pinn_cli.physics import observation_masks, observation_residuals, physics_residual, tangent, targets
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.blocks import Blocks, ChainRows
from pinn_cli.training.bordered import BorderedSystem
from pinn_cli.training.initial_motion import initial_motion
from pinn_cli.training.layout import BandLayout
from pinn_cli.training.noise_model import NoiseModel

# Prior on the readout weights, relative to the largest diagonal of the first normal matrix: keeps directions that
# nothing measures from running away. Fourier features on a period longer than the record have such directions: below
# 1e-15 their Gauss-Newton steps never settle; splines do not notice it.
RELATIVE_RIDGE = 1e-15


@dataclass(frozen=True, eq=False)
class Point:
    """Where Gauss-Newton stands.

    Attributes:
        unknowns: (size,) readout weights in the layout's order.
        parameters: (p,) uncertain parameters, in prior standard deviations from their prescribed values.
    """

    unknowns: Tensor
    parameters: Tensor

    def moved(self, step: tuple[Tensor, Tensor]) -> Point:
        """The point after a step."""
        return Point(self.unknowns + step[0], self.parameters + step[1])


class NormalEquations:
    """The weighted least-squares problem of one network, chain and record.

    Residuals and states are grouped as the network's segments are, (I, S, n), and 0 at padding.

    Args:
        network: Fixed features, linear readout.
        problem: Chain, record, uncertain parameters.
        device: Where residuals and blocks are computed.
    """

    def __init__(self, network: LinearReadout, problem: Problem, device: str = "cpu") -> None:
        self.problem, self.chain = problem, problem.chain
        self.target = targets(problem.record, problem.chain, device)
        self.network = network.to(device)
        self.observation = network.segments(self.target.observation_time)
        self.physics = network.segments(self.target.physics_time)
        self.observation_target = self.target.grouped(self.observation.gather)
        self.physics_target = self.target.grouped(self.physics.gather)
        self.layout = BandLayout(self.physics.feature, self.physics.count, problem.record.ndof)
        self.prescribed = {name: value.to(self.target.force) for name, value in problem.chain.parameters.items()}
        self.kinds = tuple(name for name in self.prescribed if any(p.kind == name for p in problem.uncertain))
        self._place_parameters()
        self.grams = {name: features.mT @ features for name, (_, features) in self._own_features().items()}
        self.begins = initial_motion(network, problem, self.layout, self.target.observation_time)
        self.ridge: float | None = None
        self._kept_point: Point | None = None
        self._kept_states: dict[int, States] = {}

    def _place_parameters(self) -> None:
        n, like, uncertain = self.problem.record.ndof, self.target.force, self.problem.uncertain
        column = [self.kinds.index(p.kind) * n + p.dof for p in uncertain]
        self.column = torch.tensor(column, dtype=torch.long, device=like.device)
        self.scale = torch.tensor([p.prior_std for p in uncertain], dtype=like.dtype, device=like.device)
        self.unknown = torch.tensor([p.unknown for p in uncertain], dtype=torch.bool, device=like.device)
        self.lower = np.array([p.lower / p.prior_std for p in uncertain])
        # 0 where a parameter is held fixed: its column then vanishes.
        spread = like.new_zeros(len(self.kinds) * n).index_copy(0, self.column, self.scale)
        self.spread = dict(zip(self.kinds, spread.reshape(-1, n), strict=True))

    def _own_features(self) -> dict[str, tuple[Segments, Tensor]]:
        """Residuals that touch their own DOF only, with rows that never change: their segments and features."""
        masks = observation_masks(self.target, self.problem.acceleration_through)
        out = {name: (self.observation, getattr(self.observation, name)) for name in masks if name != "observer"}
        if self.physics.continuity is not None:
            out["continuity"] = (self.physics, self.physics.continuity)
        return out

    def start(self) -> Point:
        """The structure at rest with its prescribed parameters."""
        zeros = self.target.force.new_zeros
        return Point(zeros(self.layout.size), zeros(len(self.scale)))

    def readout(self, point: Point) -> Tensor:
        """The readout weights of a point as the network keeps them, (channels, count, ndof)."""
        return self.layout.weights(point.unknowns).unflatten(0, (-1, self.network.channels)).movedim(1, 0).contiguous()

    def parameters(self, point: Point) -> dict[str, Tensor]:
        """Every parameter of the chain at a point, each (n,)."""
        n, out = self.problem.record.ndof, dict(self.prescribed)
        if self.kinds:
            moved = self.target.force.new_zeros(len(self.kinds) * n).index_copy(
                0, self.column, self.scale * point.parameters
            )
            for kind, by in zip(self.kinds, moved.reshape(-1, n), strict=True):
                out[kind] = out[kind] + by
        return out

    def states(self, segments: Segments, point: Point) -> States:
        """Motion at a point; kept until the point changes, since residuals, rows and losses all ask for it."""
        if point is not self._kept_point:
            self._kept_point, self._kept_states = point, {}
        if id(segments) not in self._kept_states:
            self._kept_states[id(segments)] = self._states(segments, point)
        return self._kept_states[id(segments)]

    def _states(self, segments: Segments, point: Point) -> States:
        local = self.layout.weights(point.unknowns)[segments.feature]
        continuity = None if segments.continuity is None else segments.continuity @ local
        return States(
            segments.displacement @ local, segments.velocity @ local, segments.acceleration @ local, continuity
        )

    def flat_states(self, segments: Segments, point: Point) -> States:
        """Motion at a point in the order of the times, each (N, n)."""
        displacement, velocity, acceleration, _ = self.states(segments, point)
        return States(segments.scatter(displacement), segments.scatter(velocity), segments.scatter(acceleration), None)

    def residuals(self, point: Point) -> dict[str, Tensor]:
        """Residuals by name: ``physics``, ``continuity``, those of :func:`pinn_cli.physics.observation_masks`."""
        parameters = self.parameters(point)
        observed, states = self.states(self.observation, point), self.states(self.physics, point)
        through = self.problem.acceleration_through
        out = observation_residuals(observed, self.observation_target, self.chain, parameters, through)
        out["physics"] = physics_residual(states, self.physics_target, self.chain, parameters)
        if states.continuity is not None:
            out["continuity"] = states.continuity
        return out

    def weights(self, noise: NoiseModel) -> dict[str, Tensor]:
        """Weight (n,) of every residual under a noise model, 0 where a DOF has none."""
        like = self.target.force
        mass = self.prescribed["m"].cpu().numpy()
        masks = observation_masks(self.target, self.problem.acceleration_through)
        out = {
            name: torch.as_tensor(noise.observation_weight(name, mass)).to(like) * mask for name, mask in masks.items()
        }
        out["physics"] = torch.as_tensor(1.0 / noise.physics_variance).to(like) * self.target.equation
        if self.physics.continuity is not None:
            out["continuity"] = torch.full_like(self.prescribed["m"], 1.0 / noise.continuity**2)
        return out

    def room_below(self, point: Point) -> np.ndarray:
        """(p,), the most negative step of every parameter that respects its bound; -inf without one."""
        room: np.ndarray = self.lower - point.parameters.cpu().numpy()
        return np.minimum(room, 0.0)

    def moved(self, point: Point, step: tuple[np.ndarray, np.ndarray]) -> Point:
        """The point after a step; a parameter that the step takes to its bound is at the bound, whatever the rounding.

        Args:
            point: Where the step begins.
            step: Of the readout weights (size,) and of the parameters (p,).
        """
        unknowns, parameters = (torch.as_tensor(x).to(point.unknowns) for x in step)
        lower = torch.as_tensor(self.lower).to(point.unknowns)
        held = torch.as_tensor(step[1] <= self.room_below(point), device=lower.device)
        after = point.moved((unknowns, parameters))
        return Point(after.unknowns, torch.where(held, lower, torch.maximum(after.parameters, lower)))

    def losses(self, point: Point, noise: NoiseModel) -> dict[str, float]:
        """Weighted sum of squares of every residual, of the parameters' prior and of the ridge."""
        residuals = self.residuals(point)
        weights = self.weights(noise)
        out = {name: float((weights[name] * r.square()).sum()) for name, r in residuals.items()}
        out["prior"] = float((self.precision(noise) * point.parameters.square()).sum())
        if self.begins is not None:
            out["initial"] = self.begins.loss(point.unknowns)
        out["ridge"] = (self.ridge or 0.0) * float(point.unknowns.square().sum())
        return out

    def assemble(self, point: Point, noise: NoiseModel) -> BorderedSystem:
        """Normal matrix and gradient at a point."""
        residuals, weights = self.residuals(point), self.weights(noise)
        groups, features = self.physics.feature.shape
        blocks = Blocks(groups, features, self.problem.record.ndof, len(self.kinds), self.target.force)
        own = self._own_features()
        for name, residual in residuals.items():
            if name == "physics":
                blocks.add_chain_rows(self.physics, self.rows(self.physics, point), residual, weights[name])
            elif name == "observer":
                # The observer's residual is (f - restoring force) / m - a: the rows of the restoring force over -m.
                mass = -self.parameters(point)["m"]
                rows = self.rows(self.observation, point, with_mass=False)
                blocks.add_chain_rows(self.observation, rows, residual * mass, weights[name] / mass**2)
            else:
                blocks.add_own_rows(own[name][1], self.grams[name], residual, weights[name])
        return self._system(blocks, point, self.precision(noise))

    def rows(self, segments: Segments, point: Point, with_mass: bool = True) -> ChainRows:
        """Linearised equation of motion at a point, with or without its inertia force."""
        parameters = self.parameters(point)
        displacement, velocity, acceleration, _ = self.states(segments, point)
        slope = tangent(self.chain, parameters, displacement, velocity)
        if not with_mass:
            force = self.observation_target.observer_force
            acceleration = self.chain.acceleration(displacement, velocity, force, parameters)
        return ChainRows.of(slope, parameters["m"] if with_mass else None, acceleration, self.spread)

    def uncertain_columns(self, parameter: Tensor, dof: int) -> Tensor:
        """Rows of one DOF's residual by every uncertain parameter, (..., kinds, 2) to (..., p)."""
        n = self.problem.record.ndof
        out = parameter.new_zeros((*parameter.shape[:-2], len(self.kinds), n))
        out[..., dof : dof + 2] = parameter[..., : min(2, n - dof)]
        return out.flatten(-2)[..., self.column.to(parameter.device)]

    def precision(self, noise: NoiseModel) -> Tensor:
        """(p,), prior precision of the uncertain parameters, in their units: believed ones share one spread."""
        return torch.where(self.unknown, 1.0, noise.spread**-2)

    def _system(self, blocks: Blocks, point: Point, precision: Tensor) -> BorderedSystem:
        band = self.layout.band(blocks.readout[..., : blocks.columns])
        gradient = self.layout.vector(blocks.readout[..., -1:])[:, 0]
        if self.ridge is None:
            self.ridge = RELATIVE_RIDGE * float(band[0].max())
        band[0] += self.ridge
        gradient = gradient + self.ridge * point.unknowns
        if self.begins is not None:
            self.begins.add(band, gradient, point.unknowns)
        border, corner, slope = self._border(blocks)
        corner = corner + torch.diag(precision).to(corner)
        slope = slope + precision * point.parameters
        arrays = (x.detach().cpu().numpy() for x in (band, border, corner, gradient, slope))
        return BorderedSystem(*arrays)

    def _border(self, blocks: Blocks) -> tuple[Tensor, Tensor, Tensor]:
        """Columns of the uncertain parameters: against the readout, against each other, and their gradient."""
        n, kinds = self.problem.record.ndof, len(self.kinds)
        new = self.target.force.new_zeros
        border, corner, slope = new((self.layout.size, kinds, n)), new((kinds, n, kinds, n)), new((kinds, n))
        for i in range(n) if kinds else ():
            against = self.layout.columns_of_dof(blocks.readout[:, i, :, blocks.columns : -1], i).unflatten(
                -1, (kinds, 2)
            )
            block = blocks.parameters[i, :, :-1].reshape(kinds, 2, kinds, 2)
            for x in range(min(2, n - i)):
                border[:, :, i + x] += against[..., x]
                slope[:, i + x] += blocks.parameters[i, :, -1].reshape(kinds, 2)[:, x]
                for y in range(min(2, n - i)):
                    corner[:, i + x, :, i + y] += block[:, x, :, y]
        pick = self.column
        return border.flatten(1)[:, pick], corner.flatten(2).flatten(0, 1)[pick][:, pick], slope.flatten()[pick]
