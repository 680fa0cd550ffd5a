"""The motion of a multilayer perceptron in the factors of a record, and the rows of these by all its weights."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from pinn_cli.network.linear_readout import Segments
from pinn_cli.network.mlp import MlpNetwork
from pinn_cli.network.network import States
from pinn_cli.physics import Targets, observation_masks
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.factors.constant_channels import ResponseChannels
from pinn_cli.training.factors.equation_rows import EquationsOfMotion
from pinn_cli.training.factors.factor import Residuals
from pinn_cli.training.factors.frame import EVERY, Frame
from pinn_cli.training.function_space.system import Block, block_of, forward
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_equations import Continuity, Observer
from pinn_cli.training.normal_matrix.row_pattern import RowPattern
from pinn_cli.training.normal_matrix.row_sums import RowSums

Residual = Callable[[Point], Tensor]
"""(P, R), of one point of weights and parameters."""


class NetworkFrame(Frame):
    """A network without fixed features, a structure and a record: all times are one group, whose features are none.

    Args:
        network: Of the motion; it has the weights of the point that was asked for last.
        problem: Structure, record, uncertain parameters.
        target: What is compared, at P points.

    Attributes:
        factors: All that is said of the record's unknowns but what is believed of weights and parameters.
    """

    def __init__(self, network: MlpNetwork, problem: Problem, target: Targets) -> None:
        # Without features there is no band: nothing of the other frame's is made.
        self.problem, self.dynamics, self.is_plain = problem, problem.dynamics, problem.dynamics.is_plain
        self.perceptron, self.target, self.refinement = network, target, 1
        self.averages, self.beginning = None, None
        self.prescribed = {name: value.to(target.force) for name, value in problem.structure.parameters.items()}
        self._place_parameters()
        self.pattern = RowPattern(self.dynamics, self.vector, target.force)
        # The segments as well: what is known by the identity of an object has to outlive it.
        self._time: dict[int, tuple[Segments, Tensor]] = {}
        self._weights: Tensor | None = None
        self.observation, self.physics = self.at(target.observation_time), self.at(target.physics_time)
        masks = observation_masks(target, problem.acceleration_through)
        observer = [Observer(self, masks.pop("observer"))] if "observer" in masks else []
        self.motion = EquationsOfMotion(self)
        self.factors: list[ResponseChannels | Residuals] = [
            *(ResponseChannels(self, quantity, mask) for quantity, mask in masks.items()),
            *observer,
            self.motion,
            *([Continuity(self)] if self.physics.continuity is not None else []),
            *([FirstMotion(self, problem.initial_deviation)] if problem.initial_deviation is not None else []),
        ]

    def at(self, time: Tensor) -> Segments:
        """Times (P,), s, of which the motion is asked for."""
        none = time.new_zeros(1, len(time), 0)
        continuity = None if self.perceptron.continuity == "exact" else none
        sample, feature = torch.arange(len(time), device=time.device)[None], torch.zeros(1, 0, dtype=torch.long)
        jet = none[:, None].expand(-1, 3, -1, -1)
        feature, mask = feature.to(time.device), torch.ones_like(time)[None]
        segments = Segments(sample, mask, feature, jet, continuity, 0, len(time))
        self._time[id(segments)] = segments, time
        return segments

    def states(self, segments: Segments, point: Point, part: slice = EVERY) -> States:
        """See :meth:`Frame.states`."""
        if point.unknowns is not self._weights:
            self._weights, self._kept_states = point.unknowns, {}
            vector_to_parameters(point.unknowns, self.perceptron.parameters())
        key = (id(segments), None, None)
        if key not in self._kept_states:
            self._kept_states[key] = as_group(self.perceptron(self._time[id(segments)][1]))
        return self._kept_states[key]

    def linearised(self, segments: Segments, point: Point, residuals: Residual) -> tuple[Block, Tensor, Tensor]:
        """Residuals at the times of some segments by all weights and parameters.

        Returns:
            By the weights; the residuals (R, P), detached; by the parameters in prior standard deviations (R, P, p).
        """
        key = (id(segments), None, None)
        self.states(segments, point)
        inputs, outputs, states = forward(self.perceptron, self._time[id(segments)][1])
        self._kept_states[key] = as_group(states)
        values = residuals(Point(point.unknowns, point.parameters))
        block = block_of(inputs, outputs, values)
        self._kept_states[key] = each_of(as_group(states), Tensor.detach)

        by_parameter = derivatives(lambda x: residuals(Point(point.unknowns, x)), point.parameters)
        return block, values.detach().T, by_parameter.movedim(1, 0)

    def weighted(self, factors: Sequence[ResponseChannels | Residuals], noise: NoiseModel) -> Residual:
        """The residuals of some factors over their noise, those that are compared."""
        roots = [factor.weight(noise).sqrt() for factor in factors]

        def residuals(point: Point) -> Tensor:
            pairs = zip(factors, roots, strict=True)
            return torch.cat([(factor.residual(point, EVERY) * root)[0][:, root > 0] for factor, root in pairs], 1)

        return residuals

    @property
    def by_time(self) -> list[tuple[Segments, list[ResponseChannels | Residuals]]]:
        """The factors that look at the motion at the same times."""
        all_segments = {id(factor.segments): factor.segments for factor in self.factors}.values()
        return [
            (segments, [factor for factor in self.factors if factor.segments is segments]) for segments in all_segments
        ]

    def layers(self, weights: Tensor) -> list[Tensor]:
        """A vector of all weights (w,) by layer, (fan out, fan in + 1, 1): the bias last."""
        shapes = [weight.shape for weight in self.perceptron.parameters()]
        parts = weights.split([shape.numel() for shape in shapes])
        tensors = [part.view(shape) for part, shape in zip(parts, shapes, strict=True)]
        half = len(tensors) // 2  # biases come after all weights
        return [torch.cat((w, b[:, None]), 1)[..., None] for w, b in zip(tensors[:half], tensors[half:], strict=True)]

    def flat(self, layers: Sequence[Tensor]) -> Tensor:
        """The inverse of :meth:`layers`."""
        return torch.cat([*(x[:, :-1, 0].flatten() for x in layers), *(x[:, -1, 0] for x in layers)])

    @property
    def weights(self) -> Tensor:
        """All weights of the network, (w,), as the unknowns of a point."""
        return parameters_to_vector(self.perceptron.parameters()).detach()


class FirstMotion(Residuals):
    """Displacement and velocity of every DOF where the record begins; prior standard deviations in m and m/s."""

    name = "initial"

    def __init__(self, frame: NetworkFrame, deviation: tuple[float, float]) -> None:
        super().__init__(frame)
        self.segments, self.deviation = frame.at(frame.target.observation_time[:1]), deviation

    def residual(self, point: Point, part: slice) -> Tensor:
        """See :meth:`Residuals.residual`."""
        states = self.frame.states(self.segments, point)
        return torch.cat((states.displacement, states.velocity), -1)

    def weight(self, noise: NoiseModel) -> Tensor:
        """See :meth:`Residuals.weight`."""
        return self.frame.target.force.new_tensor(self.deviation).repeat_interleave(self.frame.dynamics.ndof) ** -2

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """See :meth:`Factor.add_to`."""
        raise NotImplementedError("a network without features has no normal matrix")


def derivatives(residuals: Callable[[Tensor], Tensor], parameters: Tensor) -> Tensor:
    """(P, R, p), of residuals (P, R) by few parameters (p,): what goes back is linear in what it is weighed with.

    (Torch's own forward mode loads its compiler first, which takes seconds.)
    """
    moving = parameters.clone().requires_grad_()
    values = residuals(moving)
    if not values.requires_grad:
        return values.new_zeros(*values.shape, len(parameters))
    weights = torch.ones_like(values).requires_grad_()
    back = torch.autograd.grad(values, moving, weights, create_graph=True)[0]
    if not back.requires_grad:
        return values.new_zeros(*values.shape, len(parameters))
    columns = [torch.autograd.grad(row, weights, retain_graph=True)[0] for row in back]
    return torch.stack(columns, -1)


def each_of(states: States, change: Callable[[Tensor], Tensor]) -> States:
    """The same change of all histories of a motion."""
    continuity = None if states.continuity is None else change(states.continuity)
    return States(change(states.displacement), change(states.velocity), change(states.acceleration), continuity)


def as_group(states: States) -> States:
    """A motion (P, n) as one group of times, (1, P, n)."""
    return each_of(states, lambda history: history[None])
