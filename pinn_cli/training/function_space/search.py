"""Levenberg-Marquardt over all weights and parameters, with noise levels that follow the residuals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.mlp import MlpNetwork
from pinn_cli.training.function_space.feature_system import NotNearlyLinearError
from pinn_cli.training.function_space.kernel import Layers, layers
from pinn_cli.training.function_space.linearisation import Linearisation, Step
from pinn_cli.training.function_space.residuals import ResidualRows
from pinn_cli.training.function_space.solution import Solution
from pinn_cli.training.function_space.system import System
from pinn_cli.training.history import History, noise_weights
from pinn_cli.training.learned_parameters import LearnedParameters
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.parameter_spread import updated_spread
from pinn_cli.training.steps.discrepancy_search import SUSPICIOUS_DISCREPANCY
from pinn_cli.training.stepwise import Stepwise

# Shares of a step that are tried before the damping is raised: a step costs a factor, a share next to nothing.
SHARES = (1.0, 0.5, 0.25)
# Factors on the damping where no share helps, and where the whole step did; tries in one iteration.
MORE_DAMPING, LESS_DAMPING, TRIES = 10.0, 0.1, 8
# Noise levels follow the residuals once a loss is what the linearised residuals promised, up to a factor, or falls no
# further than by a part in one iteration.
KEPT_PROMISE, SETTLED_ENOUGH = 1.5, 0.7
# Most that a level may fall or rise at once: the linearisation reaches no further.
LARGEST_FALL, LARGEST_RISE = 0.1, 4.0
# Relative change below which levels have settled. Without model error the discrepancy may fall for ever; then this many
# steps without a gain are enough.
LEVEL_TOLERANCE, PATIENCE = 0.1, 4
# The same of the parameters' spread, which a few parameters tell to some tens of percent.
SPREAD_TOLERANCE = 0.2
# A discrepancy below this fraction of the force is below what the best load cells tell; one below that fraction of a
# load cell's own noise makes no motion better known. Stiffer physics only leaves it to the parameters to make up for
# what the network cannot follow.
FINEST_DISCREPANCY, FINEST_OF_NOISE = 3e-4, 0.02


class Loss(NamedTuple):
    """Sums of squares over their variances, which add up to the loss; ``prior``: of parameters and initial motion."""

    observation: float
    forces: float
    continuity: float
    weights: float
    prior: float

    @property
    def total(self) -> float:
        """Their sum."""
        return sum(self)


class FunctionSpaceSearch(Stepwise):
    """The training under way.

    Args:
        network: At the weights that its prior is about.
        parameters: At their prescribed values.
        rows: Which residuals.
        noise: Standard deviations of all residuals, where they begin; a large discrepancy makes the physics soft.
        precision: Where that of the weights about those that training began with begins.
        largest: The force that acts, N.
        iterations: At most.
        tolerance: Relative decrease of the loss below which training has converged, once the noise levels have settled.
        learn_spread: Whether the believed parameters' common spread follows them.
        history: Takes a row per iteration.
        solution: How steps are solved.
    """

    long_steps = True

    def __init__(
        self,
        network: MlpNetwork,
        parameters: LearnedParameters,
        rows: ResidualRows,
        noise: NoiseModel,
        precision: float,
        largest: float,
        iterations: int,
        tolerance: float,
        learn_spread: bool,
        history: History,
        solution: Solution,
    ) -> None:
        self.network, self.parameters, self.rows, self.largest = network, parameters, rows, largest
        self.noise, self.precision, self.solution = noise, precision, solution
        self.iterations, self.tolerance, self.learn_spread, self.history = iterations, tolerance, learn_spread, history
        self.start: Layers = [(w.clone(), b.clone()) for w, b in layers(network)]
        self.damping, self.iteration, self.idle, self.stop_reason = 0.0, 0, 0, ""

    def step(self) -> bool:
        """See :meth:`Stepwise.step`."""
        if self.stop_reason:
            return False
        before = self.loss()
        if self.iteration == 0:
            self._note(before)
        linear = Linearisation(self.network, self.parameters, self.rows, self.noise)
        step, after = self._improve(linear, before)
        self.iteration += 1
        if step is None:
            self.stop_reason = "no step improves it"
        elif after.total < KEPT_PROMISE * step.loss or after.total > (1.0 - SETTLED_ENOUGH) * before.total:
            settled = self._settle(step, after)
            least = (1.0 - self.tolerance) * before.total
            self._judge(after.total > least, step.loss > least, settled)
        if self.iteration == self.iterations and not self.stop_reason:
            self.stop_reason = "iteration limit"
        self._note(after)
        return True

    @torch.no_grad()
    def loss(self) -> Loss:
        """Where network, parameters and levels are now."""
        values, noise = self.parameters(), self.noise
        observed = self.rows.observed(self.network(self.rows.target.observation_time), values, noise)
        enforced = self.rows.enforced(self.network(self.rows.target.physics_time), values, noise)
        forces, continuity = enforced.tensor_split([self.rows.force_count])
        moved = sum(float((w - v).square().sum()) for w, v in zip(self._flat(), self._flat(self.start), strict=True))
        seen, balance, continuous = (float(x.square().sum()) for x in (observed, forces, continuity))
        prior = float(self._standardised().square().sum())
        if self.rows.deviation is not None:
            begins = self.rows.initial(self.network(self.rows.target.observation_time[:1]))
            prior += float(begins.square().sum())
        return Loss(seen, balance, continuous, self.precision * moved, prior)

    def _flat(self, position: Layers | None = None) -> list[Tensor]:
        return [tensor for layer in position or layers(self.network) for tensor in layer]

    def _standardised(self) -> Tensor:
        """(p,), distances of the parameters from their prescribed values in prior standard deviations."""
        parameters = self.parameters
        return parameters.moved.detach() * parameters.unit / parameters.prior_deviation

    def _improve(self, linear: Linearisation, before: Loss) -> tuple[Step | None, Loss]:
        """Take the first step, or share of it, that lowers the loss.

        Returns:
            The step, None where there is none, and the loss that was reached.
        """
        here = [(w.clone(), b.clone()) for w, b in layers(self.network)]
        to_start = [(w0 - w, b0 - b) for (w0, b0), (w, b) in zip(self.start, here, strict=True)]
        x, moved = self._standardised(), self.parameters.moved.detach().clone()
        for _ in range(TRIES):
            step = self._solved(linear, to_start, x)
            for share in SHARES:
                self._move(here, moved, step, share)
                after = self.loss()
                if after.total < before.total:
                    self.damping = self._lower(self.damping) if share == 1.0 else self.damping
                    return step, after
            self.damping = max(MORE_DAMPING * self.damping, self.precision)
        self._move(here, moved, step, 0.0)
        return None, before

    def _solved(self, linear: Linearisation, to_start: Layers, x: Tensor) -> Step:
        total = self.precision + self.damping
        try:
            return linear.step(self.solution.system(linear, total), to_start, x, self.precision)
        except NotNearlyLinearError as error:
            self.solution.settle_for_dense(linear, error)
            return linear.step(self.solution.system(linear, total), to_start, x, self.precision)

    def _lower(self, damping: float) -> float:
        """Less, and none at all once it is a small part of the prior's precision."""
        return LESS_DAMPING * damping if damping > self.precision else 0.0

    @torch.no_grad()
    def _move(self, here: Layers, moved: Tensor, step: Step, share: float) -> None:
        for target, (w, b), (dw, db) in zip(layers(self.network), here, step.weights, strict=True):
            target[0].copy_(w + share * dw)
            target[1].copy_(b + share * db)
        parameters = self.parameters
        proposed = step.parameters * parameters.prior_deviation / parameters.unit
        parameters.moved.copy_(moved + share * (proposed - moved))
        parameters.respect_bounds()

    def _settle(self, step: Step, after: Loss) -> bool:
        """Have the levels follow residuals, weights and parameters (MacKay 1992).

        Returns:
            Whether they stay where they are.
        """
        kept = step.system.kept(self.iteration)
        first = self.rows.observed_count * self.rows.points
        forces = slice(first, first + self.rows.force_count * self.rows.points)
        free = max(float(kept[forces].sum()), 1.0)
        excess, promised = after.forces / free, float(step.residual[forces].square().sum()) / free
        # Forces that the next step will balance say nothing against the model.
        excess = max(1.0, promised) if excess > 1.0 else excess
        unknowns = len(kept) - float(kept.sum())
        before, spread = self.noise.discrepancy, self.parameters.spread
        self._follow(step.system, excess)
        growth = float(np.clip(unknowns / max(after.weights, 1e-12), LARGEST_FALL, 1.0 / LARGEST_FALL))
        self.precision = growth * self.precision
        changes = np.abs(np.log([growth, self.noise.discrepancy / before, self.parameters.spread / spread]))
        return bool(changes[:2].max() < LEVEL_TOLERANCE and changes[2] < SPREAD_TOLERANCE)

    def _judge(self, gained_nothing: bool, nothing_to_gain: bool, settled: bool) -> None:
        """End once the levels stay and the residuals promise nothing, or nothing was gained for long."""
        self.idle = self.idle + 1 if gained_nothing else 0
        if self.idle >= PATIENCE or (nothing_to_gain and settled):
            self.stop_reason = "converged"

    def _follow(self, system: System, excess: float) -> None:
        """Take discrepancy and spread as the residuals and the parameters ask for.

        A discrepancy that is too large is squared down rather than rooted: the residuals shrink with it.
        """
        change = excess if excess < 1.0 else np.sqrt(excess)
        level = self.noise.discrepancy * float(np.clip(change, LARGEST_FALL, LARGEST_RISE))
        self.noise = replace(self.noise, discrepancy=max(level, self._finest(self.noise)))
        believed, before = ~self.parameters.unknown, self.parameters.spread
        if not self.learn_spread or not bool(believed.any()):
            return
        x = (before * self._standardised())[believed].cpu().numpy()
        variance = before**2 * system.parameter_covariance.diagonal()[believed].cpu().numpy()
        change = updated_spread(x, variance, before) / before
        # Parameters that hardly move from where they are believed to be let their spread fall a little at a time.
        spread = before * max(change**2 if change < 1.0 else change, LARGEST_FALL)
        # How far off a search has the parameters that is far from its end says nothing about how far off they are.
        far = level > SUSPICIOUS_DISCREPANCY * self.largest
        self.parameters.spread = min(spread, max(1.0, before)) if far else spread

    def _finest(self, noise: NoiseModel) -> float:
        """The least discrepancy that is looked for, N."""
        measured = noise.force[np.isfinite(noise.force)]
        of_noise = FINEST_OF_NOISE * float(measured.min()) if measured.size else 0.0
        return max(FINEST_DISCREPANCY * self.largest, of_noise)

    def _note(self, loss: Loss) -> None:
        weights = {**noise_weights(self.noise), "weights": self.precision}
        self.history.add(self.iteration, loss._asdict(), weights)

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`Stepwise.state_dict`; what training began with is the settings' and the seed's."""
        return {
            "iteration": self.iteration,
            "idle": self.idle,
            "stop_reason": self.stop_reason,
            "damping": self.damping,
            "precision": self.precision,
            "dense": self.solution.dense,
            "discrepancy": self.noise.discrepancy,
            "spread": self.parameters.spread,
            "network": self.network.state_dict(),
            "parameters": self.parameters.state_dict(),
            "history": self.history.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`Stepwise.load_state_dict`."""
        self.iteration, self.idle, self.stop_reason = state["iteration"], state["idle"], state["stop_reason"]
        self.damping, self.precision = state["damping"], state["precision"]
        self.solution.dense = state["dense"]
        self.noise, self.parameters.spread = replace(self.noise, discrepancy=state["discrepancy"]), state["spread"]
        self.network.load_state_dict(state["network"])
        self.parameters.load_state_dict(state["parameters"])
        self.history.load_state_dict(state["history"])
