"""The least-squares problem of all weights of a network and the parameters, as the damped minimiser asks for it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.function_space.feature_system import (
    FeatureSystem,
    NotNearlyLinearError,
    coefficient_prior,
    feature_operations,
    follows_features,
)
from pinn_cli.training.function_space.network_frame import NetworkFrame
from pinn_cli.training.function_space.system import Block, DenseSystem, Linearised, System, dense_operations, pull, push
from pinn_cli.training.minimise import FIRST_DAMPING, Point
from pinn_cli.training.noise_model import NoiseLevels

# Share of the unknowns that the linear model of the units may miss for its bands to be taken.
MISSED_UNKNOWNS = 0.03
# Shares of a step that are tried before the damping is raised: a step costs a factor, a share next to nothing.
SHARES = (0.5, 0.25)
# What the loss of a factor counts as in the history; those of sensors as observation.
TERMS = {"physics": "forces", "continuity": "continuity", "initial": "prior"}


class NetworkEquations:
    """The weights' prior is about those that training began with, so the system may be solved between residuals.

    Args:
        frame: Of the record, its network at the weights that the prior is about.
        precision: Of that prior; it follows the weights.
        most_residuals: For which the whole matrix of a step is to fit.

    Attributes:
        dense: Whether steps are solved by the factor of the whole matrix; None: not yet known.
    """

    is_plain, is_linear = True, False

    def __init__(self, frame: NetworkFrame, precision: float, most_residuals: int) -> None:
        self.frame, self.precision, self.most_residuals = frame, precision, most_residuals
        self.origin = frame.weights.clone()
        self.dense: bool | None = None if follows_features(frame.perceptron) else True

    def start(self) -> Point:
        """The network as it is, with prescribed parameters."""
        return Point(self.origin, torch.zeros_like(self.frame.scale))

    def room_below(self, point: Point) -> np.ndarray:
        """(p,), the most negative step of every parameter that respects its bound; -inf without one."""
        return np.minimum(self.frame.lower - point.parameters.cpu().numpy(), 0.0)

    def moved(self, point: Point, step: tuple[Tensor, Tensor]) -> Point:
        """The point after a step, parameters within their bounds."""
        lower = torch.as_tensor(self.frame.lower).to(point.parameters)
        after = point.moved((step[0], torch.as_tensor(step[1]).to(lower)))
        return Point(after.unknowns, torch.maximum(after.parameters, lower))

    def retries(self, start: Point, refused: Point, noise: NoiseLevels) -> Iterator[Point]:
        """See :meth:`pinn_cli.training.minimise.Equations.retries`: shares of the step, which cost next to nothing."""
        for share in SHARES:
            unknowns = torch.lerp(start.unknowns, refused.unknowns, share)
            yield Point(unknowns, torch.lerp(start.parameters, refused.parameters, share))

    def deviation(self, noise: NoiseLevels) -> Tensor:
        """(p,), standard deviations of the parameters over those that were prescribed: believed ones share a spread."""
        return torch.where(self.frame.unknown, torch.ones_like(self.frame.scale), noise.spread)

    @torch.no_grad()
    def losses(self, point: Point, noise: NoiseLevels) -> dict[str, float]:
        """Sums of squares over their variances, which add up to the loss; ``prior``: parameters and first motion."""
        out: defaultdict[str, float] = defaultdict(float, dict.fromkeys(("observation", "forces", "continuity"), 0.0))
        out["weights"] = self.precision * float((point.unknowns - self.origin).square().sum())
        out["prior"] = float((point.parameters / self.deviation(noise)).square().sum())
        for factor in self.frame.factors:
            out[TERMS.get(factor.name, "observation")] += factor.loss(point, noise.records[0])
        return dict(out)

    def assemble(self, point: Point, noise: NoiseLevels) -> NetworkSystem:
        """The residuals linearised at a point."""
        return NetworkSystem(self, point, noise)

    def system(self, linear: Linearised, total: float, further: Sequence[Block] = ()) -> System:
        """That of a step, or of the posterior, whichever way takes fewer operations.

        Args:
            linear: The residuals.
            total: Precision of the weights, damping included.
            further: Linearisations of quantities whose variance will be asked for.

        Raises:
            DivergenceError: It is singular in double precision.
        """
        if self.dense is None:
            self.dense = dense_operations(linear.blocks) < feature_operations(linear.blocks)
        if self.dense:
            return DenseSystem(linear, total)
        return FeatureSystem(linear, total, coefficient_prior(self.frame.perceptron, linear.time), further)

    def settle_for_dense(self, linear: Linearised, error: NotNearlyLinearError) -> None:
        """Solve with the whole matrix from now on.

        Raises:
            NotNearlyLinearError: The one given, where the whole matrix is too large.
        """
        if len(linear.residual) > self.most_residuals:
            raise error
        self.dense = True

    def for_bands(self, linear: Linearised, further: Sequence[Block]) -> System:
        """That of the posterior, which leaves out next to none of the network's freedom where the whole matrix fits.

        Raises:
            DivergenceError: It is singular in double precision.
        """
        try:
            system = self.system(linear, self.precision, further)
            if not isinstance(system, FeatureSystem) or system.missed_unknowns() < MISSED_UNKNOWNS:
                return system
        except NotNearlyLinearError as error:
            self.settle_for_dense(linear, error)
        if len(linear.residual) > self.most_residuals:
            return system
        self.dense = True
        return self.system(linear, self.precision)


@dataclass(frozen=True, eq=False)
class SolvedStep:
    """A damped Gauss-Newton step; the system is solved for the step itself, not factored for any other.

    Attributes:
        system: That was solved.
        way: Of the weights (w,), and of the parameters (p,).
        residual: What the linearised residuals become, (M,).
        forces: Which of them are those of the equations of motion.
    """

    system: System
    way: tuple[Tensor, np.ndarray]
    residual: Tensor
    forces: slice

    def step(self, system: NetworkSystem, room: np.ndarray) -> tuple[Tensor, np.ndarray]:
        """See :meth:`pinn_cli.training.normal_matrix.bordered.SharedFactor.step`; bounds are met by moving."""
        return self.way


class NetworkSystem:
    """The residuals linearised at a point, and the steps that they allow.

    |r + J dw + J_p (x' - x)|^2 + precision |w + dw - w_0|^2 + damping |dw|^2 + |x'|^2

    Attributes:
        linear: The residuals, by the parameters in their deviations under these levels.
    """

    def __init__(self, equations: NetworkEquations, point: Point, noise: NoiseLevels) -> None:
        self.equations, frame, model = equations, equations.frame, noise.records[0]
        self.unit = equations.deviation(noise)
        self.parameters, self.from_origin = point.parameters / self.unit, point.unknowns - equations.origin
        blocks: list[Block] = []
        residuals: list[Tensor] = []
        by_parameter: list[Tensor] = []
        for segments, factors in frame.by_time:
            if factors[0] is frame.motion:
                first = sum(block.size for block in blocks)
                self.forces = slice(first, first + int(frame.target.equation.sum()) * segments.samples)
            block, values, by = frame.linearised(segments, point, frame.weighted(factors, model))
            blocks.append(block)
            residuals.append(values.flatten())
            by_parameter.append(by.flatten(0, 1) * self.unit)
        self.linear = Linearised(blocks, torch.cat(residuals), torch.cat(by_parameter), frame.target.physics_time)

    def factor(self, damping: float) -> SolvedStep | None:
        """The step with so much damping, in ``FIRST_DAMPING`` of the weights' precision; None where there is none.

        Raises:
            NotNearlyLinearError: Conjugate gradients do not solve it, and the whole matrix is too large.
        """
        total = self.equations.precision * (1.0 + damping / FIRST_DAMPING)
        try:
            return self._solved(total)
        except NotNearlyLinearError as error:
            self.equations.settle_for_dense(self.linear, error)
        except DivergenceError:
            return None
        return self.factor(damping)

    def _solved(self, total: float) -> SolvedStep:
        linear, frame, share = self.linear, self.equations.frame, self.equations.precision / total
        from_origin = push(linear.blocks, frame.layers(self.from_origin))[:, 0]
        target = linear.residual - share * from_origin - linear.by_parameter @ self.parameters
        system = self.equations.system(linear, total)
        # The residuals of a regularised least-squares problem are its multipliers.
        multiplier = system.solved(target[:, None])
        weights = -share * self.from_origin - frame.flat(pull(linear.blocks, multiplier)) / total
        multiplier = multiplier[:, 0]
        parameters = self.unit * (-(linear.by_parameter.T @ multiplier) - self.parameters)
        return SolvedStep(system, (weights, parameters.cpu().numpy()), multiplier, self.forces)

    def decrease(self, step: tuple[Tensor, np.ndarray]) -> float:
        """What the system's own step takes off the loss."""
        linear = self.linear
        gradient = self.equations.frame.flat(pull(linear.blocks, linear.residual[:, None]))
        gradient += self.equations.precision * self.from_origin
        slope = (linear.by_parameter.T @ linear.residual + self.parameters) / self.unit
        return -float(gradient @ step[0] + slope @ torch.as_tensor(step[1]).to(slope))
