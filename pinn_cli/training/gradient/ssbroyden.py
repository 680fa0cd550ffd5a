"""Training by self-scaled Broyden steps, which do best on PINNs of a few thousand weights."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import whole_number
from pinn_cli.training.gradient.inverse_hessian import update
from pinn_cli.training.gradient.line_search import LineSearch, Trial
from pinn_cli.training.gradient.objective import Evaluation, Objective
from pinn_cli.training.gradient.optimiser import GRADIENT_VANISHED, NOTHING_LOWER, Optimiser
from pinn_cli.training.gradient.quasi_newton import QuasiNewtonTraining


@dataclass
class SsBroyden(QuasiNewtonTraining):
    """Self-scaled Broyden with a strong-Wolfe line search, in float64.

    Urban, Stefanou & Pons 2025, "Unveiling the optimization process of physics informed neural networks"; Kiyani et al.
    2025, "Optimizing the optimizer for physics-informed neural networks and Kolmogorov-Arnold networks".

    Attributes:
        most_weights: Weights and uncertain parameters at most; their inverse Hessian takes 8 bytes times the square.
            Other settings are those of :class:`QuasiNewtonTraining`.

    Raises:
        InputError: A setting outside its range.
    """

    name = "ssbroyden"

    dtype: str = field(init=False, default="float64")
    most_weights: int = 8000

    def __post_init__(self) -> None:
        super().__post_init__()
        self.most_weights = whole_number("training.most_weights", self.most_weights, least=1)

    def quasi_newton(self, objective: Objective) -> Optimiser:
        """See :meth:`QuasiNewtonTraining.quasi_newton`."""
        count = sum(variable.numel() for variable in objective.variables)
        if count > self.most_weights:
            raise InputError(
                "training",
                self.name,
                f"lbfgs for a network of {count} weights",
                f"its inverse Hessian takes {8e-9 * count**2:.2g} GB; training.most_weights is {self.most_weights}, "
                "and network.width and network.depth say how many there are",
            )
        return SsBroydenSteps(self.tolerance)


class SsBroydenSteps(Optimiser):
    """Self-scaled Broyden steps along -H g, each as long as a strong-Wolfe line search says.

    Variables at their bound whom the step would take below it stay there, and a step ends where the first of the
    others gets to its own.

    Args:
        tolerance: Largest entry of the gradient at which the training ends.
    """

    def __init__(self, tolerance: float) -> None:
        self.tolerance = tolerance
        self.inverse: Tensor | None = None
        # Of the gradient at the end of the last step, so that the inverse Hessian need not be read again for it.
        self.product: tuple[Tensor, Tensor] | None = None

    def step(self, objective: Objective, evaluation: Evaluation) -> str:
        """See :meth:`Optimiser.step`."""
        line = _Line(objective, evaluation)
        if float(line.projected.abs().amax()) <= self.tolerance:
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
        gradient = line.projected
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
            # The first guess has the scale of the curvature along the first step (Nocedal & Wright, eq. 6.20).
            scale = ys / float(y @ y)
            self.inverse = torch.eye(len(s), dtype=s.dtype, device=s.device).mul_(scale)
            curvature = float(s @ s) / scale
        end = torch.where((point <= line.lower) & (end > 0), torch.zeros_like(end), end)
        applied = update(self.inverse, s, y, curvature, end)
        self.product = None if applied is None else (end, applied)

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`Optimiser.state_dict`."""
        inverse = {} if self.inverse is None else {"inverse": self.inverse}
        product = {} if self.product is None else {"gradient": self.product[0], "applied": self.product[1]}
        return {**inverse, **product}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`Optimiser.load_state_dict`."""
        self.inverse = state["inverse"].clone() if "inverse" in state else None
        self.product = (state["gradient"].clone(), state["applied"].clone()) if "gradient" in state else None


class _Line:
    """Where an iteration starts, and what it has seen on its way."""

    def __init__(self, objective: Objective, evaluation: Evaluation) -> None:
        self.objective, self.evaluation, self.gradient = objective, evaluation, objective.gradient(evaluation)
        self.start, self.lower = objective.vector, objective.lower
        self.projected = objective.projected_gradient(self.start, evaluation)
        self.at_bound = self.start <= self.lower
        self.seen: dict[float, tuple[Tensor, Evaluation]] = {}

    def search(self, direction: Tensor, gradient: Tensor, first: float) -> tuple[Trial, Tensor, Tensor] | None:
        """The accepted point, with direction and gradient; None where nothing lower lies on the line."""
        self.seen.clear()
        falling = direction < 0
        room = ((self.lower - self.start) / direction)[falling]
        largest = float(room.amin()) if len(room) else math.inf

        def at(step: float) -> tuple[float, float]:
            point = torch.maximum(self.start + step * direction, self.lower)
            evaluation = self.objective.move(point)
            self.seen[step] = (point, evaluation)
            return evaluation.loss.item(), float(self.objective.gradient(evaluation) @ direction)

        slope = float(gradient @ direction)
        if not (slope < 0 and largest > 0):
            return None
        trial = LineSearch(at, Trial(0.0, self.evaluation.loss.item(), slope), largest)(first)
        return None if trial is None else (trial, direction, gradient)

    def accept(self, trial: Trial) -> tuple[Tensor, Tensor]:
        """Move there for good; the point and the gradient there."""
        point, evaluation = self.seen[trial.step]
        self.objective.put(point)
        self.objective.remember(evaluation)
        return point, self.objective.gradient(evaluation)

    def stay(self) -> None:
        """Back to the start."""
        self.objective.put(self.start)
        self.objective.remember(self.evaluation)
