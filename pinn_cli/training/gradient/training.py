"""What trainings by gradient share: a network, its weighted loss and an optimiser, from problem to estimate."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from typing import Any

import torch

from pinn_cli.network.base import Network, NetworkDesign
from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.random_start import RandomStart
from pinn_cli.physics import targets
from pinn_cli.record.record import Response
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import one_of, positive_number, whole_number
from pinn_cli.training.base import Training
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.gradient.descent import Descent
from pinn_cli.training.gradient.history import History
from pinn_cli.training.gradient.learned_parameters import LearnedParameters
from pinn_cli.training.gradient.losses import Losses
from pinn_cli.training.gradient.objective import Objective
from pinn_cli.training.gradient.optimiser import Optimiser
from pinn_cli.training.gradient.readout_scaling import scale_readout
from pinn_cli.training.gradient.weight_settings import read_weights
from pinn_cli.training.network_response import network_response
from pinn_cli.training.stepwise import train

DTYPES = {"float32": torch.float32, "float64": torch.float64}


class GradientTraining(Training):
    """An optimiser on every collocation point at once. A new one is a file here and a file in ``conf/training``.

    Args:
        iterations: Steps in each stage.
        stages: Stages; the optimiser keeps its memory from one to the next.
        physics_growth: Factor on the weights of the equations of motion from stage to stage.
        weights: See :func:`pinn_cli.training.gradient.weight_settings.read_weights`.
        collocation_points: See :class:`pinn_cli.training.gradient.losses.Losses`.
        dtype: ``float32`` or ``float64``.
        history_every: Iterations from one row of the history to the next.

    Raises:
        InputError: A setting outside its range.
    """

    name: str

    def __init__(
        self,
        iterations: int,
        stages: int,
        physics_growth: float,
        weights: Mapping[str, float | None] | str | None,
        collocation_points: int | None,
        dtype: str,
        history_every: int,
    ) -> None:
        self.iterations = whole_number("training.iterations", iterations, least=1)
        self.stages = whole_number("training.stages", stages, least=1)
        self.physics_growth = positive_number("training.physics_growth", physics_growth)
        self.weights = read_weights(weights)
        self.collocation_points = collocation_points
        if collocation_points is not None:
            whole_number("training.collocation_points", collocation_points, least=2)
        self.dtype = DTYPES[one_of("training.dtype", dtype, tuple(DTYPES))]
        self.history_every = whole_number("training.history_every", history_every, least=1)

    @abstractmethod
    def optimiser(self, objective: Objective) -> Optimiser:
        """A fresh one for the objective's variables."""

    @property
    @abstractmethod
    def remedy(self) -> str:
        """What a user may try where it diverges."""

    def solve(self, problem: Problem, design: NetworkDesign, run: RunContext) -> Estimate:
        """See :meth:`Training.solve`."""
        if problem.priors is not None:
            raise InputError("training", self.name, "gauss_newton with scheme=bayesian", "it gives no likelihood")
        # Clock times have too few digits in float32: begin at 0.
        record = replace(problem.record, time=problem.record.time - problem.record.time[0])
        shifted = replace(problem, record=record)
        losses = Losses(shifted, self.collocation_points, run.device, self.dtype)
        parameters = LearnedParameters(shifted, self.dtype).to(run.device)
        # What one run finds is no business of the next.
        weights = deepcopy(self.weights)
        objective = Objective(losses, self.network(shifted, design, run), parameters, weights)
        steps = self.iterations * self.stages
        history = History(self.name, run.progress, steps, self.history_every, run.watch)
        descent = Descent(
            objective, self.optimiser(objective), history, self.iterations, self.stages, self.physics_growth,
            self.name, self.remedy,
        )  # fmt: skip
        try:
            train(descent, run)
        finally:
            history.close()
        every = targets(record, shifted.chain, run.device, self.dtype)
        response = replace(network_response(shifted, every, objective.network, parameters), time=problem.record.time)
        unknown = Response.unknown(problem.record.time, problem.record.ndof)
        return Estimate(response, unknown, parameters.estimates(), history.table(), self._summary(descent))

    def network(self, problem: Problem, design: NetworkDesign, run: RunContext) -> Network:
        """The network that is trained: at its random start, and in units of the record's amplitudes."""
        network = design.build(problem.record, self.dtype)
        if isinstance(network, RandomStart):
            network.reset(run.seed)
        if isinstance(network, LinearReadout):
            scale_readout(network, problem.record)
        return network.to(run.device)

    def _summary(self, descent: Descent) -> dict[str, Any]:
        last = descent.history.rows[-1]
        return {
            "iterations": descent.iteration,
            "stop_reason": descent.stop_reason,
            "loss": sum(value for name, value in last.items() if name.startswith("loss_")),
            "network_weights": sum(weight.numel() for weight in descent.objective.network.parameters()),
            "dtype": str(self.dtype).removeprefix("torch."),
        }
