"""One iteration of a quasi-Newton method with a dense inverse Hessian, within bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from pinn_cli.training.gradient.inverse_hessian import InverseHessian
from pinn_cli.training.gradient.line_search import LineSearch, Trial
from pinn_cli.training.gradient.objective import Evaluation, Objective
from pinn_cli.training.gradient.optimiser import GRADIENT_VANISHED, NOTHING_LOWER, Optimiser
from pinn_cli.training.gradient.variables import FlatVariables


class DenseQuasiNewton(Optimiser):
    """Self-scaled Broyden steps along -H g, each as long as a strong-Wolfe line search says.

    Variables at their bound whom the step would take below it stay there, and a step ends where the first of the
    others gets to its own.

    Args:
        tolerance: Largest entry of the gradient at which the training ends.
    """

    def __init__(self, tolerance: float) -> None:
        self.tolerance = tolerance
        self.inverse: InverseHessian | None = None
        # Of the gradient at the end of the last step, so that the inverse Hessian need not be read again for it.
        self.product: tuple[Tensor, Tensor] | None = None

    def step(self, objective: Objective, evaluation: Evaluation) -> str:
        """See :meth:`Optimiser.step`."""
        variables = FlatVariables(objective)
        line = _Line(variables, variables.with_gradient(evaluation))
        if float(line.blocked(line.gradient).abs().amax()) <= self.tolerance:
            return GRADIENT_VANISHED
        found = line.search(*self._direction(line), first=self._first_step(line))
        if found is None and self.inverse is not None:
            self.inverse = self.product = None
            found = line.search(*self._direction(line), first=self._first_step(line))
        if found is None:
            line.stay()
            return NOTHING_LOWER
        self._learn(line, *found)
        return ""

    def _first_step(self, line: _Line) -> float:
        """One; a change of one in all variables together where nothing is known yet."""
        return 1.0 if self.inverse is not None else min(1.0, 1.0 / float(line.gradient.abs().sum()))

    def _direction(self, line: _Line) -> tuple[Tensor, Tensor]:
        """-H g, and g, both 0 in the variables that must not move."""
        gradient = line.blocked(line.gradient)
        while True:
            direction = torch.where(gradient == 0, gradient, -self._applied(gradient))
            further = line.at_bound & (direction < 0)
            if not bool(further.any()):
                return direction, gradient
            gradient = gradient.masked_fill(further, 0.0)

    def _applied(self, gradient: Tensor) -> Tensor:
        if self.inverse is None:
            return gradient
        if self.product is not None and torch.equal(self.product[0], gradient):
            return self.product[1]
        return self.inverse @ gradient

    def _learn(self, line: _Line, trial: Trial, direction: Tensor, gradient: Tensor) -> None:
        point, end = line.accept(trial)
        s = point - line.start
        y = torch.where(gradient == 0, gradient, end - gradient)
        curvature = -trial.step * float(s @ gradient)
        if self.inverse is None:
            ys = float(y @ s)
            if not ys > 0:
                return
            self.inverse = InverseHessian.identity(len(s), s)
            # The first guess has the scale of the curvature along the first step (Nocedal & Wright, eq. 6.20).
            scale = ys / float(y @ y)
            self.inverse.matrix.mul_(scale)
            curvature = float(s @ s) / scale
        end = torch.where((point <= line.lower) & (end > 0), torch.zeros_like(end), end)
        applied = self.inverse.update(s, y, curvature, end)
        self.product = None if applied is None else (end, applied)

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`Optimiser.state_dict`."""
        inverse = {} if self.inverse is None else {"inverse": self.inverse.matrix}
        product = {} if self.product is None else {"gradient": self.product[0], "applied": self.product[1]}
        return {**inverse, **product}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`Optimiser.load_state_dict`."""
        self.inverse = InverseHessian(state["inverse"].clone()) if "inverse" in state else None
        self.product = (state["gradient"].clone(), state["applied"].clone()) if "gradient" in state else None


class _Line:
    """Where an iteration starts, and what it has seen on its way."""

    def __init__(self, variables: FlatVariables, evaluation: Evaluation) -> None:
        assert evaluation.gradient is not None
        self.variables, self.evaluation, self.gradient = variables, evaluation, evaluation.gradient
        self.start, self.lower = variables.vector, variables.lower
        self.at_bound = self.start <= self.lower
        self.seen: dict[float, tuple[Tensor, Evaluation]] = {}

    def blocked(self, gradient: Tensor) -> Tensor:
        """0 where a step downhill would leave the bounds at once."""
        return gradient.masked_fill(self.at_bound & (gradient > 0), 0.0)

    def search(self, direction: Tensor, gradient: Tensor, first: float) -> tuple[Trial, Tensor, Tensor] | None:
        """The accepted point, with direction and gradient; None where nothing lower lies on the line."""
        self.seen.clear()
        falling = direction < 0
        room = ((self.lower - self.start) / direction)[falling]
        largest = float(room.amin()) if len(room) else math.inf

        def at(step: float) -> tuple[float, float]:
            point = torch.maximum(self.start + step * direction, self.lower)
            evaluation = self.variables.move(point)
            self.seen[step] = (point, evaluation)
            assert evaluation.gradient is not None
            return evaluation.loss.item(), float(evaluation.gradient @ direction)

        slope = float(gradient @ direction)
        if not (slope < 0 and largest > 0):
            return None
        trial = LineSearch(at, Trial(0.0, self.evaluation.loss.item(), slope), largest)(first)
        return None if trial is None else (trial, direction, gradient)

    def accept(self, trial: Trial) -> tuple[Tensor, Tensor]:
        """Move there for good; the point and the gradient there."""
        point, evaluation = self.seen[trial.step]
        self.variables.put(point)
        self.variables.objective.remember(evaluation)
        assert evaluation.gradient is not None
        return point, evaluation.gradient

    def stay(self) -> None:
        """Back to the start."""
        self.variables.put(self.start)
        self.variables.objective.remember(self.evaluation)
