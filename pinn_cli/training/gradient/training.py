"""What trainings by gradient share: a network, its weighted loss and an optimiser, from problem to estimate.

Readout weights in units of the record's amplitudes, so that one learning rate suits every record.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.network import Network, NetworkDesign
from pinn_cli.physics import estimated_response, targets
from pinn_cli.record.channels import motion_amplitudes
from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import one_of, positive_number, whole_number
from pinn_cli.system.quantities import MOTION
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.estimator import Training
from pinn_cli.training.gradient.losses import (
    Evaluation,
    LearnedParameters,
    Losses,
    Objective,
    check_finite,
    checked_weights,
)
from pinn_cli.training.history import History, Stepwise, train

# The features that reach least, of which some lie at the ends of the record and are hardly seen, count as slow.
SLOW_FEATURES = 0.1
DTYPES = {"float32": torch.float32, "float64": torch.float64}


class _Scaled(nn.Module):
    """A weight as the product of a fixed scale and what is learned."""

    scale: Tensor

    def __init__(self, scale: Tensor) -> None:
        super().__init__()
        self.register_buffer("scale", scale)

    def forward(self, learned: Tensor) -> Tensor:
        """The weight."""
        return self.scale * learned

    def right_inverse(self, weight: Tensor) -> Tensor:
        """What to learn from."""
        return weight / self.scale


def scale_readout(network: LinearReadout, record: Record) -> None:
    """Have a network learn its readout weights in units of the record's amplitudes; ``readout`` becomes a product.

    The slow features of an output have its amplitude as their unit. Faster ones have less, in proportion to how far
    they drive displacement, velocity or acceleration: unscaled, Fourier features of high frequency throw the
    accelerations about at every step of a gradient method. The features of a spline are nearly all alike.
    """
    amplitudes = motion_amplitudes(record)
    reach = _reach(network, record, [amplitudes[name] for name in (*MOTION, MOTION[1])])
    slow = reach.quantile(SLOW_FEATURES, dim=1, keepdim=True)
    unit = torch.tensor([amplitudes["displacement"], amplitudes["velocity"]][: network.channels]).to(reach)
    scale = unit[:, None] * (slow / reach).clamp(max=1.0)
    parametrize.register_parametrization(network, "readout", _Scaled(scale[..., None]))


def _reach(network: LinearReadout, record: Record, amplitudes: Sequence[float]) -> Tensor:
    """(channels, count): the most that a weight of one adds to any part of the motion, over that part's amplitude.

    Parts are displacement, velocity, acceleration and the discontinuity of velocity.
    """
    segments = network.segments(torch.as_tensor(record.time).to(network.readout))
    reach = network.readout.new_zeros(segments.count)
    for features, amplitude in zip((*segments.orders, segments.continuity), amplitudes, strict=True):
        if features is not None:
            peak = features.abs().amax(1) / amplitude
            reach.scatter_reduce_(0, segments.feature.flatten(), peak.flatten(), "amax")
    # What no sample sees is not slow.
    return torch.where(reach > 0, reach, reach.amax()).unflatten(0, (-1, network.channels)).T


class Optimiser(ABC):
    """Moves the variables of an objective downhill, one iteration at a time."""

    @abstractmethod
    def step(self, objective: Objective, evaluation: Evaluation) -> str:
        """One iteration from where the variables are now, of which the objective's evaluation is given.

        Returns:
            Why no further iteration would help; empty where one may.
        """

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """All that the next iteration depends on but the variables, which stand at the start of it."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from there."""


@dataclass
class GradientTraining(Training):
    """An optimiser on every collocation point at once. A new one is a file here and a file in ``conf/training``.

    Attributes:
        iterations: Steps in each stage.
        stages: Stages; the optimiser keeps its memory from one to the next.
        physics_growth: Factor on the weights of the equations of motion from stage to stage.
        weights: See :func:`pinn_cli.training.gradient.losses.checked_weights`.
        collocation_points: See :class:`pinn_cli.training.gradient.losses.Losses`.
        dtype: ``float32`` or ``float64``.
        history_every: Iterations from one row of the history to the next.

    Raises:
        InputError: A setting outside its range.
    """

    name: ClassVar[str]

    iterations: int = 3000
    stages: int = 1
    physics_growth: float = 10.0
    weights: Mapping[str, float | None] | str | None = None
    collocation_points: int | None = 512
    dtype: Annotated[str, tuple(DTYPES)] = "float64"
    history_every: int = 50

    def __post_init__(self) -> None:
        self.iterations = whole_number("training.iterations", self.iterations, least=1)
        self.stages = whole_number("training.stages", self.stages, least=1)
        self.physics_growth = positive_number("training.physics_growth", self.physics_growth)
        self.weights = checked_weights(self.weights)
        if self.collocation_points is not None:
            whole_number("training.collocation_points", self.collocation_points, least=2)
        one_of("training.dtype", self.dtype, tuple(DTYPES))
        self.history_every = whole_number("training.history_every", self.history_every, least=1)

    @abstractmethod
    def optimiser(self, objective: Objective) -> Optimiser:
        """A fresh one for the objective's variables."""

    @property
    @abstractmethod
    def remedy(self) -> str:
        """What a user may try where it diverges."""

    def solve(self, problem: JointProblem, design: NetworkDesign, run: RunContext) -> Estimate:
        """See :meth:`Training.solve`."""
        if problem.priors:
            raise InputError("training", self.name, "gauss_newton with scheme=bayesian", "it gives no likelihood")
        alone = problem.alone
        # Clock times have too few digits in float32: begin at 0.
        time = alone.record.time
        alone = replace(alone, record=replace(alone.record, time=time - time[0]))
        descent = self.descent(alone, design, run)
        with descent.history:
            train(descent, run)
        network, parameters = descent.objective.network, descent.objective.parameters
        all_targets = targets(alone.record, alone.dynamics, run.device, DTYPES[self.dtype])
        with torch.no_grad():
            observed, enforced = network(all_targets.observation_time), network(all_targets.physics_time)
            response = estimated_response(alone.record, alone.dynamics, parameters(), observed, enforced)
        response = replace(response, time=time)
        unknown = Response.unknown(time, alone.record.ndof)
        summary = {**descent.summary(), "dtype": self.dtype, "device": run.device}
        return Estimate(response, unknown, parameters.estimates(), descent.history.table(), summary)

    def descent(self, problem: Problem, design: NetworkDesign, run: RunContext) -> Descent:
        """The training at its start."""
        history = History(run.progress, run.watch, self.name, self.iterations * self.stages, self.history_every)
        return Descent(self, self.objective(problem, design, run), history)

    def objective(self, problem: Problem, design: NetworkDesign, run: RunContext) -> Objective:
        """The loss of a network at its random start, its readout in units of the record's amplitudes."""
        dtype = DTYPES[self.dtype]
        losses = Losses(problem, self.collocation_points, run.device, dtype)
        network: Network = design.build(problem.record, dtype)
        network.reset(run.seed)
        if isinstance(network, LinearReadout):
            scale_readout(network, problem.record)
        parameters = LearnedParameters(problem, dtype)
        return Objective(losses, network.to(run.device), parameters.to(run.device), checked_weights(self.weights))


class Descent(Stepwise):
    """A training under way, stage after stage: a reason to stop ends a stage, that of the last one the training."""

    def __init__(self, training: GradientTraining, objective: Objective, history: History) -> None:
        self.training, self.objective, self.history = training, objective, history
        self.optimiser = training.optimiser(objective)
        self.iteration, self.stop_reason = 0, ""
        self.stage, self.until = -1, 0

    def step(self) -> bool:
        """See :meth:`Stepwise.step`; the row of the last iteration is written when it is asked for one more."""
        if self.iteration == self.until and not self.stop_reason:
            self._next_stage()
        evaluation = self.objective()
        check_finite(evaluation, self.iteration, self.training.name, self.training.remedy)
        weights = {name: evaluation.weights[name] for name in evaluation.terms}
        self.history.add(self.iteration, evaluation.terms, weights, last=bool(self.stop_reason))
        if self.stop_reason:
            return False
        reason = self.optimiser.step(self.objective, evaluation)
        self.iteration += 1
        if reason and self.stage == self.training.stages - 1:
            self.stop_reason = reason
        elif reason:
            self.until = self.iteration
        return True

    def _next_stage(self) -> None:
        if self.stage == self.training.stages - 1:
            self.stop_reason = "iteration limit"
            return
        self.stage += 1
        self.until = self.iteration + self.training.iterations
        self.objective.begin_stage(self.stage, self.training.physics_growth**self.stage)

    def summary(self) -> dict[str, Any]:
        """For run.json."""
        last = self.history.rows[-1]
        return {
            "iterations": self.iteration,
            "stop_reason": self.stop_reason,
            "loss": sum(value for name, value in last.items() if name.startswith("loss_")),
            "network_weights": sum(weight.numel() for weight in self.objective.network.parameters()),
        }

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`Stepwise.state_dict`."""
        return {
            "iteration": self.iteration,
            "stop_reason": self.stop_reason,
            "stage": self.stage,
            "until": self.until,
            "network": self.objective.network.state_dict(),
            "parameters": self.objective.parameters.state_dict(),
            "weights": dict(self.objective.weights),
            "optimiser": self.optimiser.state_dict(),
            "history": self.history.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`Stepwise.load_state_dict`."""
        self.iteration, self.stop_reason = state["iteration"], state["stop_reason"]
        self.stage, self.until = state["stage"], state["until"]
        self.objective.physics_factor = self.training.physics_growth ** max(self.stage, 0)
        self.objective.network.load_state_dict(state["network"])
        self.objective.parameters.load_state_dict(state["parameters"])
        self.objective.weights = dict(state["weights"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.history.load_state_dict(state["history"])
