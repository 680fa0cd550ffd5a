"""The paper's loss terms (eqs. 10a to 10c) at collocation points, free of units, for first-order training.

A term is a mean over the points of a sum of squares over the DOFs, each residual over the largest measured value of its
kind. A weight lambda says that the noise of a residual is its scale over sqrt(lambda), so a prior counts as one point.

Weights lambda of the loss terms: fixed ones, and those under which every term pulls equally hard at the start. Their
sum is a function of a network's weights and the chain's uncertain parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.utils import parameters_to_vector

from pinn_cli.network.network import Network, States
from pinn_cli.physics import hold_delay, observation_residuals, physics_residual, targets
from pinn_cli.record.between_samples import evenly_spaced
from pinn_cli.record.channels import motion_amplitudes
from pinn_cli.record.record import Record
from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES
from pinn_cli.record.spectrum import periodogram, signal_band
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.settings.legal_values import non_negative_number
from pinn_cli.system.parameters import ParameterVector
from pinn_cli.training.estimate import ParameterEstimate

# Points that follow this much of a channel's power leave out a tenth of its amplitude at most.
BULK_OF_THE_POWER = 0.99
# The paper's. Those of physics are of the DOFs whose force is measured, and of the others too unless they are given.
PAPER_WEIGHTS: dict[str, float | None] = {"observation": 1.0, "continuity": 10.0, "physics": 100.0, "unforced": None}
EQUALISED = "equalised"
# The terms of the equations of motion, whose weights grow from stage to stage.
PHYSICS = ("forced", "unforced")
# Residuals are over the largest measured value, so this loss is some million times what any start gives.
DIVERGED = 1e12


class Losses:
    """The loss terms of one problem; everything that does not change from step to step is prepared once.

    Args:
        problem: Structure, record, uncertain parameters.
        points: Number of collocation points, a uniform subset of the samples; the sensors are read at the same ones, as
            the authors of the paper do; None: every sample.
        device, dtype: Of the tensors.

    Raises:
        InputError: Too few points for the record's band.
    """

    def __init__(self, problem: Problem, points: int | None, device: str, dtype: torch.dtype) -> None:
        record = problem.record
        self.dynamics, self.through = problem.dynamics, problem.acceleration_through
        self.simultaneous = hold_delay(record) == 0
        everything = targets(record, problem.dynamics, device, dtype)
        self.target = everything.at(torch.as_tensor(_samples(record, points), device=device))
        self.deviation = problem.initial_deviation
        amplitudes = motion_amplitudes(record)
        self.scales = {
            quantity: _largest(getattr(record, quantity)) or amplitudes[quantity] for quantity in RESPONSE_QUANTITIES
        }
        self.scales["observer"] = self.scales["acceleration"]
        inertia = float(problem.structure.parameters["m"].max()) * amplitudes["acceleration"]
        self.scales["force"] = _largest(record.force) or inertia
        self.scales["continuity"] = amplitudes["velocity"]

    def states(self, network: Network) -> tuple[States, States]:
        """Motion when the sensors were read and at the collocation points (later by half a step of a held force)."""
        target = self.target
        if self.simultaneous:
            states = network(target.observation_time)
            return states, states
        joint = network(torch.cat((target.observation_time, target.physics_time)))
        halves = [(None, None) if x is None else x.tensor_split(2) for x in joint]
        observed, enforced = zip(*halves, strict=True)
        return States(*observed), States(*enforced)

    def terms(self, network: Network, parameters: LearnedParameters) -> dict[str, Tensor]:
        """Unweighted loss terms by name, scalars; those that a problem does not have are left out."""
        observed, enforced = self.states(network)
        values = parameters()
        residuals = observation_residuals(observed, self.target, self.dynamics, values, self.through)
        squares = {name: self._mean_square(residual, name).sum() for name, residual in residuals.items()}
        terms = {"observation": torch.stack(list(squares.values())).sum()}
        if enforced.continuity is not None:
            terms["continuity"] = self._mean_square(enforced.continuity, "continuity").sum()
        physics = self._mean_square(physics_residual(enforced, self.target, self.dynamics, values), "force")
        terms["forced"] = (physics * self.target.measured_force).sum()
        terms["unforced"] = (physics * self.target.unforced).sum()
        if parameters.count or self.deviation is not None:
            terms["prior"] = (parameters.prior() + self._initial(network)) / len(self.target.physics_time)
        return terms

    def _initial(self, network: Network) -> Tensor:
        """Sum of squares of the motion that the record begins with, in prior standard deviations, where it has any."""
        if self.deviation is None:
            return self.target.force.new_zeros(())
        states = network(self.target.observation_time[:1])
        displacement, velocity = self.deviation
        return (states.displacement / displacement).square().sum() + (states.velocity / velocity).square().sum()

    def _mean_square(self, residual: Tensor, kind: str) -> Tensor:
        """(N, n) to (n,)."""
        return (residual / self.scales[kind]).square().mean(0)


def _samples(record: Record, points: int | None) -> np.ndarray:
    """Indices of a uniform subset of the samples, first and last included."""
    available = len(record.time)
    points = available if points is None else min(points, available)
    highest = _highest_frequency(record)
    needed = min(available, math.ceil(2.0 * highest * record.duration))
    if points < needed:
        hint = f"the record goes up to {highest:.3g} Hz and lasts {record.duration:.4g} s"
        raise InputError("training.collocation_points", points, f"a whole number >= {needed}, or null", hint)
    return evenly_spaced(available, points)


def _highest_frequency(record: Record) -> float:
    """Frequency that holds, with all below it, nearly all power of every measured channel but its noise, Hz."""
    highest = 0.0
    for quantity in QUANTITIES:
        for channel in getattr(record, quantity)[:, record.sensors(quantity)].T:
            frequency, power = periodogram(channel, record.step)
            power = np.cumsum(power[frequency <= signal_band(channel, record.step)])
            highest = max(highest, float(frequency[np.searchsorted(power, BULK_OF_THE_POWER * power[-1])]))
    return highest


def _largest(measured: np.ndarray) -> float:
    """Largest absolute value of any channel; 0 where there is none."""
    return float(np.max(np.abs(measured), initial=0.0, where=np.isfinite(measured)))


def checked_weights(given: Mapping[str, float | None] | str | None) -> dict[str, float | None] | str:
    """Fixed weights, completed by the paper's, or ``equalised``.

    Raises:
        InputError: Anything else.
    """
    if given == EQUALISED:
        return EQUALISED
    if given is not None and not isinstance(given, Mapping):
        raise InputError("training.weights", given, f"{EQUALISED}, or numbers for {', '.join(PAPER_WEIGHTS)}")
    weights = dict(PAPER_WEIGHTS)
    for name, value in (given or {}).items():
        if name not in PAPER_WEIGHTS:
            raise InputError(f"training.weights.{name}", value, f"one of {', '.join(PAPER_WEIGHTS)}")
        if name != "unforced" or value is not None:
            non_negative_number(f"training.weights.{name}", value)
        weights[name] = value
    return weights


def fixed_weights(given: Mapping[str, float | None]) -> dict[str, float]:
    """By term of :meth:`Losses.terms`."""
    by_term = {
        "observation": given["observation"],
        "continuity": given["continuity"],
        "forced": given["physics"],
        "unforced": given["physics"] if given["unforced"] is None else given["unforced"],
        "prior": 1.0,
    }
    return {name: float(weight) for name, weight in by_term.items() if weight is not None}


def equalised_weights(losses: Losses, network: Network, parameters: LearnedParameters) -> dict[str, float]:
    """Weights with which every term's gradient by the network's weights has the norm of the observations'.

    Wang, Teng & Perdikaris 2021 ("Understanding and mitigating gradient flow pathologies in physics-informed neural
    networks") and Wang et al. 2023 ("An expert's guide to training physics-informed neural networks", algorithm 1) do
    so again and again; here it is done once, since quasi-Newton methods and line searches need one loss. A term without
    a gradient (continuity, where a network begins at zero) keeps its fixed weight, and so does the prior.
    """
    weights, norms = fixed_weights(PAPER_WEIGHTS), {}
    for name, term in losses.terms(network, parameters).items():
        if term.requires_grad:
            parts = torch.autograd.grad(
                term, list(network.parameters()), retain_graph=True, allow_unused=True, materialize_grads=True
            )
            norms[name] = float(torch.stack([part.norm() for part in parts]).norm())
    for name, norm in norms.items():
        if name != "prior" and norm > 0 and norms["observation"] > 0:
            weights[name] = norms["observation"] / norm
    return weights


class LearnedParameters(nn.Module):
    """Every parameter of the chain; those that may move start at their prescribed values.

    Attributes:
        moved: (p,), distance of each uncertain parameter from its prescribed value, over its order of magnitude: a step
            of 0.01 is about one per cent, whatever the unit.
    """

    unit: Tensor
    prior_std: Tensor
    lower: Tensor

    def __init__(self, problem: Problem, dtype: torch.dtype) -> None:
        super().__init__()
        self.uncertain = problem.uncertain
        self.vector = ParameterVector(problem.structure.parameters, self.uncertain)
        for name, values in self.vector.nominal.items():
            self.register_buffer(f"nominal_{name}", values.detach().to(dtype))
        unit, spread, lower = (
            torch.tensor([getattr(p, name) for p in self.uncertain], dtype=torch.float64)
            for name in ("step", "prior_std", "lower")
        )
        self.register_buffer("unit", unit.to(dtype))
        self.register_buffer("prior_std", spread.to(dtype))
        self.register_buffer("lower", (lower / unit).to(dtype))
        self.moved = nn.Parameter(torch.zeros(self.count, dtype=dtype))

    @property
    def count(self) -> int:
        """Number of parameters that may move, p."""
        return len(self.uncertain)

    def forward(self) -> dict[str, Tensor]:
        """Every parameter by kind, at the nearest point within the bounds."""
        nominal = {name: self.get_buffer(f"nominal_{name}") for name in self.vector.nominal}
        return self.vector.values(self.unit * self._inside, nominal)

    @property
    def _inside(self) -> Tensor:
        """(p,), without a gradient beyond a bound."""
        return self.moved.clamp(min=self.lower)

    @torch.no_grad()
    def respect_bounds(self) -> None:
        """Put parameters that a step has taken below their least value back onto it."""
        self.moved.clamp_(min=self.lower)

    def prior(self) -> Tensor:
        """Sum of squared distances from the prescribed values, in prior standard deviations."""
        return (self.unit / self.prior_std * self._inside).square().sum()

    def estimates(self) -> list[ParameterEstimate]:
        """Where the parameters are now; a gradient method knows no standard deviations."""
        distance = (self.unit * self.moved).detach().cpu().double().tolist()
        held = (self.moved <= self.lower).cpu().tolist()
        nothing = (math.nan, math.nan, math.nan)
        return [
            ParameterEstimate(p, p.value(p.lower if h else d), *nothing, h)
            for p, d, h in zip(self.uncertain, distance, held, strict=True)
        ]


@dataclass(eq=False)
class Evaluation:
    """The loss at one point.

    Attributes:
        loss: The sum of the weighted terms, a scalar; with a graph behind it until the gradient is known.
        terms: Weighted loss terms by name.
        weights: By name of term.
        at: (variables,), where.
        known_gradient: (variables,), as one vector; None where nobody has asked for it yet.
    """

    loss: Tensor
    terms: dict[str, Tensor]
    weights: dict[str, float]
    at: Tensor
    known_gradient: Tensor | None = None


class Objective:
    """What an optimiser makes small.

    The network's weights are moved, and the uncertain parameters of the chain.

    Attributes:
        weights: By term; given as :func:`checked_weights` returns them.
        physics_factor: On the weights of the equations of motion; a training may raise it as it goes on.
    """

    def __init__(
        self,
        losses: Losses,
        network: Network,
        parameters: LearnedParameters,
        weights: Mapping[str, float | None] | str,
    ) -> None:
        self.losses, self.network, self.parameters = losses, network, parameters
        self.equalised = weights == EQUALISED
        self.weights = fixed_weights(PAPER_WEIGHTS if isinstance(weights, str) else weights)
        self.physics_factor = 1.0
        self._evaluation: Evaluation | None = None

    def begin_stage(self, stage: int, physics_factor: float) -> None:
        """Weigh the terms as the stage (counted from 0) does."""
        self.physics_factor = physics_factor
        if stage == 0 and self.equalised:
            self.weights = equalised_weights(self.losses, self.network, self.parameters)

    def term_weights(self) -> dict[str, float]:
        """Weight of every term of :meth:`Losses.terms`, those of the equations of motion times their factor."""
        return {name: w * (self.physics_factor if name in PHYSICS else 1.0) for name, w in self.weights.items()}

    @property
    def variables(self) -> list[nn.Parameter]:
        """What is moved: the network's weights, then the chain's uncertain parameters, if any."""
        return [*self.network.parameters(), *(self.parameters.parameters() if self.parameters.count else ())]

    def __call__(self) -> Evaluation:
        """The loss at the nearest point within the bounds; it need not be finite. With its gradient it is kept."""
        evaluation, at, weights = self._evaluation, self.vector, self.term_weights()
        is_known = evaluation is not None and evaluation.known_gradient is not None
        if evaluation is None or not is_known or evaluation.weights != weights or not torch.equal(evaluation.at, at):
            terms = {name: weights[name] * term for name, term in self.terms().items()}
            evaluation = self._evaluation = Evaluation(torch.stack(list(terms.values())).sum(), terms, weights, at)
        return evaluation

    def terms(self) -> dict[str, Tensor]:
        """Unweighted ones by name."""
        return self.losses.terms(self.network, self.parameters)

    def gradient(self, evaluation: Evaluation) -> Tensor:
        """(variables,), of an evaluation made where the variables are now, or asked before; its graph is let go."""
        if evaluation.known_gradient is None:
            parts = torch.autograd.grad(evaluation.loss, self.variables, allow_unused=True, materialize_grads=True)
            evaluation.loss = evaluation.loss.detach()
            evaluation.terms = {name: term.detach() for name, term in evaluation.terms.items()}
            evaluation.known_gradient = torch.cat([part.reshape(-1) for part in parts])
        return evaluation.known_gradient

    def projected_gradient(self, evaluation: Evaluation) -> Tensor:
        """That gradient, 0 where a step downhill from there would leave the bounds at once."""
        gradient = self.gradient(evaluation)
        return gradient.masked_fill((evaluation.at == self.lower) & (gradient > 0), 0.0)

    def give(self, gradient: Tensor) -> None:
        """Have an optimiser of torch find a gradient (variables,) at the variables."""
        for variable, part in zip(self.variables, self.split(gradient), strict=True):
            variable.grad = part

    @property
    def vector(self) -> Tensor:
        """(variables,), a copy."""
        return parameters_to_vector(self.variables).detach().clone()

    @property
    def lower(self) -> Tensor:
        """(variables,), the least value that each may have: that of a bounded parameter, -inf elsewhere."""
        held = self.parameters.lower if self.parameters.count else self.parameters.lower.new_zeros(0)
        count = sum(variable.numel() for variable in self.variables)
        return torch.cat((held.new_full((count - len(held),), -math.inf), held))

    @torch.no_grad()
    def put(self, vector: Tensor) -> None:
        """Give the variables these values, (variables,)."""
        for variable, part in zip(self.variables, self.split(vector), strict=True):
            variable.copy_(part)

    def split(self, vector: Tensor) -> list[Tensor]:
        """Its parts, each shaped like its variable."""
        sizes = [variable.numel() for variable in self.variables]
        return [part.view_as(v) for part, v in zip(vector.split(sizes), self.variables, strict=True)]


def check_finite(evaluation: Evaluation, iteration: int, method: str, remedy: str) -> None:
    """Stop a training that has left the finite numbers.

    Raises:
        DivergenceError: It has; the message names the worst term, the iteration and what to try.
    """
    if evaluation.loss.item() < DIVERGED:  # false for NaN too
        return
    values = {name: term.item() for name, term in evaluation.terms.items()}
    worst = max(values, key=lambda name: math.inf if math.isnan(values[name]) else values[name])
    raise DivergenceError(f"{method} diverged: loss_{worst} is {values[worst]:.3g} at iteration {iteration}; {remedy}")
