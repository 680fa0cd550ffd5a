"""Gradient training under way: objective, optimiser and history, step by step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pinn_cli.training.gradient.history import History
from pinn_cli.training.gradient.objective import Objective, check_finite
from pinn_cli.training.gradient.optimiser import Optimiser
from pinn_cli.training.stepwise import Stepwise


class Descent(Stepwise):
    """Stages of one optimiser, which keeps its memory from one stage to the next.

    A reason to stop ends a stage; that of the last one ends the training.

    Args:
        objective: What is made small.
        optimiser: By what.
        history: Takes a row now and then.
        iterations: In each stage.
        stages: How many there are.
        physics_growth: Factor on the weights of the equations of motion from stage to stage.
        method: Name of the optimiser, for messages.
        remedy: What to try where it diverges.
    """

    def __init__(
        self,
        objective: Objective,
        optimiser: Optimiser,
        history: History,
        iterations: int,
        stages: int,
        physics_growth: float,
        method: str,
        remedy: str,
    ) -> None:
        self.objective, self.optimiser, self.history = objective, optimiser, history
        self.iterations, self.stages, self.physics_growth = iterations, stages, physics_growth
        self.method, self.remedy = method, remedy
        self.iteration, self.stop_reason = 0, ""
        self.stage, self.until = -1, 0

    def step(self) -> bool:
        """See :meth:`Stepwise.step`; the row of the last iteration is written when it is asked for one more."""
        if self.iteration == self.until and not self.stop_reason:
            self._next_stage()
        evaluation = self.objective()
        check_finite(evaluation, self.iteration, self.method, self.remedy)
        weights = {name: evaluation.weights[name] for name in evaluation.terms}
        self.history.add(self.iteration, evaluation.terms, weights, last=bool(self.stop_reason))
        if self.stop_reason:
            return False
        reason = self.optimiser.step(self.objective, evaluation)
        self.iteration += 1
        if reason and self.stage == self.stages - 1:
            self.stop_reason = reason
        elif reason:
            self.until = self.iteration
        return True

    def _next_stage(self) -> None:
        if self.stage == self.stages - 1:
            self.stop_reason = "iteration limit"
            return
        self.stage += 1
        self.until = self.iteration + self.iterations
        self.objective.begin_stage(self.stage, self.physics_growth**self.stage)

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`Stepwise.state_dict`."""
        return {
            "iteration": self.iteration,
            "stop_reason": self.stop_reason,
            "stage": self.stage,
            "until": self.until,
            "network": self.objective.network.state_dict(),
            "parameters": self.objective.parameters.state_dict(),
            "weights": self.objective.weights.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "history": self.history.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`Stepwise.load_state_dict`."""
        self.iteration, self.stop_reason = state["iteration"], state["stop_reason"]
        self.stage, self.until = state["stage"], state["until"]
        self.objective.physics_factor = self.physics_growth ** max(self.stage, 0)
        self.objective.network.load_state_dict(state["network"])
        self.objective.parameters.load_state_dict(state["parameters"])
        self.objective.weights.load_state_dict(state["weights"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.history.load_state_dict(state["history"])
