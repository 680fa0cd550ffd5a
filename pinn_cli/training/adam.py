"""First-order training: the paper's algorithm 1, full-batch Adam."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd
import torch
from torch import Tensor
from tqdm import tqdm

from pinn_cli.errors import DivergenceError, InputError
from pinn_cli.legal_values import entries, finite_number, is_finite_number, one_of, positive_number, whole_number
from pinn_cli.network.base import Network, NetworkDesign
from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.random_start import RandomStart
from pinn_cli.physics import estimated_response, targets
from pinn_cli.record.record import Response
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.base import Training
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.learned_parameters import LearnedParameters
from pinn_cli.training.losses import Losses, LossWeights
from pinn_cli.training.readout_scaling import scale_readout

DTYPES = {"float32": torch.float32, "float64": torch.float64}
# Residuals are over the largest measured value, so this loss is some million times what any start gives.
DIVERGED = 1e12


class Adam(Training):
    """Adam on every collocation point at once, with fixed loss weights.

    Args:
        iterations: Steps in each stage.
        stages: Stages; the optimiser keeps its memory from one to the next.
        physics_growth: Factor on the weights of the equations of motion from stage to stage.
        learning_rate: Step of the network's weights.
        parameter_learning_rate: Step of the uncertain parameters, relative to their prescribed values.
        betas: Decay rates of Adam's two moments.
        weight_decay: Of the network's weights.
        weights: See :class:`pinn_cli.training.losses.LossWeights`.
        collocation_points: See :class:`pinn_cli.training.losses.Losses`.
        dtype: ``float32`` or ``float64``.
        history_every: Iterations from one row of the history to the next.

    Raises:
        InputError: A setting outside its range.
    """

    def __init__(
        self,
        iterations: int = 2000,
        stages: int = 2,
        physics_growth: float = 10.0,
        learning_rate: float = 1e-3,
        parameter_learning_rate: float = 5e-4,
        betas: Sequence[float] = (0.99, 0.999),
        weight_decay: float = 1e-5,
        weights: Mapping[str, float | None] | None = None,
        collocation_points: int | None = 512,
        dtype: str = "float32",
        history_every: int = 50,
    ) -> None:
        self.iterations = whole_number("training.iterations", iterations, least=1)
        self.stages = whole_number("training.stages", stages, least=1)
        self.physics_growth = positive_number("training.physics_growth", physics_growth)
        self.learning_rate = positive_number("training.learning_rate", learning_rate)
        self.parameter_learning_rate = positive_number("training.parameter_learning_rate", parameter_learning_rate)
        self.betas = _betas(betas)
        self.weight_decay = finite_number("training.weight_decay", weight_decay)
        if self.weight_decay < 0:
            raise InputError("training.weight_decay", weight_decay, "a finite number >= 0")
        self.weights = LossWeights.read({} if weights is None else weights)
        self.collocation_points = collocation_points
        if collocation_points is not None:
            whole_number("training.collocation_points", collocation_points, least=2)
        self.dtype = DTYPES[one_of("training.dtype", dtype, tuple(DTYPES))]
        self.history_every = whole_number("training.history_every", history_every, least=1)

    def solve(self, problem: Problem, design: NetworkDesign, run: RunContext) -> Estimate:
        """See :meth:`Training.solve`."""
        if problem.priors is not None:
            raise InputError("training", "adam", "gauss_newton with scheme=bayesian", "it gives no likelihood")
        # Clock times have too few digits in float32: begin at 0.
        record = replace(problem.record, time=problem.record.time - problem.record.time[0])
        shifted = replace(problem, record=record)
        losses = Losses(shifted, self.collocation_points, run.device, self.dtype)
        network = self._network(shifted, design, run)
        parameters = LearnedParameters(shifted, self.dtype).to(run.device)
        history = History(run.progress, self.iterations * self.stages, self.history_every)
        try:
            self._train(network, parameters, losses, history)
        finally:
            history.close()
        response = replace(self._response(shifted, network, parameters, run), time=problem.record.time)
        unknown = Response.unknown(problem.record.time, problem.record.ndof)
        return Estimate(response, unknown, parameters.estimates(), history.table(), self._summary(network, history))

    def _network(self, problem: Problem, design: NetworkDesign, run: RunContext) -> Network:
        network = design.build(problem.record, self.dtype)
        if isinstance(network, RandomStart):
            network.reset(run.seed)
        if isinstance(network, LinearReadout):
            scale_readout(network, problem.record)
        return network.to(run.device)

    def _train(self, network: Network, parameters: LearnedParameters, losses: Losses, history: History) -> None:
        groups: list[dict[str, Any]] = [{"params": list(network.parameters()), "weight_decay": self.weight_decay}]
        if parameters.count:
            # No weight decay: their prior is a term of the loss.
            groups.append({"params": list(parameters.parameters()), "lr": self.parameter_learning_rate})
        optimiser = torch.optim.Adam(groups, lr=self.learning_rate, betas=self.betas)
        last = self.iterations * self.stages
        for iteration in range(last + 1):
            weights = self._stage_weights(iteration)
            terms = {name: weights[name] * term for name, term in losses.terms(network, parameters).items()}
            loss = torch.stack(list(terms.values())).sum()
            self._check(loss, terms, iteration)
            history.add(iteration, terms, weights)
            if iteration < last:
                optimiser.zero_grad(set_to_none=True)
                loss.backward()
                optimiser.step()
                parameters.respect_bounds()

    def _stage_weights(self, iteration: int) -> dict[str, float]:
        stage = min(iteration // self.iterations, self.stages - 1)
        return self.weights.by_term(self.physics_growth**stage)

    def _check(self, loss: Tensor, terms: Mapping[str, Tensor], iteration: int) -> None:
        if loss.item() < DIVERGED:  # false for NaN too
            return
        values = {name: term.item() for name, term in terms.items()}
        worst = max(values, key=lambda name: math.inf if math.isnan(values[name]) else values[name])
        raise DivergenceError(
            f"adam diverged: loss_{worst} is {values[worst]:.3g} at iteration {iteration}; "
            f"try a training.learning_rate below {self.learning_rate:g}"
        )

    @torch.no_grad()
    def _response(self, problem: Problem, network: Network, parameters: LearnedParameters, run: RunContext) -> Response:
        every = targets(problem.record, problem.chain, run.device, self.dtype)
        at_observation, at_physics = network(every.observation_time), network(every.physics_time)
        return estimated_response(problem.record, problem.chain, parameters(), at_observation, at_physics)

    def _summary(self, network: Network, history: History) -> dict[str, Any]:
        return {
            "iterations": self.iterations * self.stages,
            "stop_reason": "iteration limit",
            "loss": sum(value for name, value in history.rows[-1].items() if name.startswith("loss_")),
            "network_weights": sum(weight.numel() for weight in network.parameters()),
            "dtype": str(self.dtype).removeprefix("torch."),
        }


class History:
    """A row of weighted loss terms and weights every so many iterations and at the end, and the progress bar."""

    def __init__(self, progress: bool, iterations: int, every: int) -> None:
        self.rows: list[dict[str, float]] = []
        self.iterations, self.every = iterations, every
        self.started = time.perf_counter()
        disable = None if progress else True
        self.bar = tqdm(total=iterations, disable=disable, unit="iteration", desc="adam", leave=False)

    def add(self, iteration: int, terms: Mapping[str, Tensor], weights: Mapping[str, float]) -> None:
        """Note the loss terms after so many steps."""
        self.bar.update(iteration - self.bar.n)
        if iteration % self.every and iteration != self.iterations:
            return
        losses = {f"loss_{name}": term.item() for name, term in terms.items()}
        self.rows.append(
            {
                "iteration": iteration,
                "seconds": time.perf_counter() - self.started,
                **losses,
                **{f"weight_{name}": weights[name] for name in terms},
            }
        )
        self.bar.set_postfix({name.removeprefix("loss_"): f"{loss:.2g}" for name, loss in losses.items()})

    def close(self) -> None:
        """Take the bar away."""
        self.bar.close()

    def table(self) -> pd.DataFrame:
        """All rows."""
        return pd.DataFrame(self.rows)


def _betas(betas: Sequence[float]) -> tuple[float, float]:
    given = entries(betas)
    if len(given) != 2 or not all(is_finite_number(beta) and 0 <= beta < 1 for beta in given):
        raise InputError("training.betas", betas, "two numbers from 0 to below 1", "[0.99, 0.999] in the paper")
    return float(given[0]), float(given[1])
