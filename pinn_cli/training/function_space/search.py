"""Damped Gauss-Newton over all weights and parameters, with noise levels that follow the residuals step by step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from pinn_cli.training.function_space.equations import NetworkEquations, SolvedStep
from pinn_cli.training.history import History, Stepwise, noise_weights
from pinn_cli.training.minimise import FIRST_DAMPING, Descent, Point
from pinn_cli.training.noise_model import NoiseLevels, NoiseModel, updated_spread
from pinn_cli.training.steps.discrepancy_search import SUSPICIOUS_DISCREPANCY

# Noise levels follow the residuals once a loss is what the linearised residuals promised, up to a factor, or falls no
# further than by a part in one iteration.
AS_PROMISED, SETTLED_ENOUGH = 1.5, 0.7
# Most that a level may fall or rise at once: the linearisation reaches no further.
LARGEST_FALL, LARGEST_RISE = 0.1, 4.0
# Relative change below which levels have settled. Without model error the discrepancy may fall for ever; then this many
# steps without a gain are enough.
LEVEL_TOLERANCE, IDLE_STEPS = 0.1, 4
# The same of the parameters' spread, which a few parameters tell to some tens of percent.
SPREAD_TOLERANCE = 0.2
# A discrepancy below this fraction of the force is below what the best load cells tell; one below that fraction of a
# load cell's own noise makes no motion better known. Stiffer physics only leaves it to the parameters to make up for
# what the network cannot follow.
FINEST_OF_FORCE, FINEST_OF_LOAD_CELL = 3e-4, 0.02


class FunctionSpaceSearch(Stepwise):
    """The training under way.

    Args:
        equations: Of the network at the weights that its prior is about.
        noise: Standard deviations of all residuals, where they begin; a large discrepancy makes the physics soft.
        largest: The force that acts, N.
        iterations, tolerance, learn_spread: See
            :func:`pinn_cli.training.function_space.training.solved_in_function_space`.
        history: Takes a row per iteration.
    """

    long_steps = True

    def __init__(
        self,
        equations: NetworkEquations,
        noise: NoiseModel,
        largest: float,
        iterations: int,
        tolerance: float,
        learn_spread: bool,
        history: History,
    ) -> None:
        self.equations, self.noise, self.largest = equations, NoiseLevels((noise,)), largest
        self.iterations, self.tolerance, self.learn_spread, self.history = iterations, tolerance, learn_spread, history
        self.point = equations.start()
        self.damping, self.iteration, self.idle, self.stop_reason = 0.0, 0, 0, ""

    def step(self) -> bool:
        """See :meth:`Stepwise.step`."""
        if self.stop_reason:
            return False
        losses = self.losses()
        if self.iteration == 0:
            self._note(losses)
        # Any gain will do: when the steps have gained enough is judged below, once the levels have followed.
        descent = Descent(self.equations, self.noise, self.point, 0.0, losses.update)
        before, descent.damping = descent.loss, self.damping
        descent.advance(0)
        # A small damping is a whole step's again: levels and linearisation have changed.
        self.point, self.damping = descent.point, descent.damping if descent.damping > FIRST_DAMPING else 0.0
        self.iteration += 1
        after, promised, least = descent.loss, before - descent.promised, (1.0 - self.tolerance) * before
        if descent.steps == 0:
            self.stop_reason = "no step improves it"
        elif after < AS_PROMISED * promised or after > (1.0 - SETTLED_ENOUGH) * before:
            settled = self._settle(descent.chord, losses)
            # The end: the levels stay and the residuals promise nothing, or nothing was gained for long.
            self.idle = self.idle + 1 if after > least else 0
            if self.idle >= IDLE_STEPS or (promised > least and settled):
                self.stop_reason = "converged"
        if self.iteration == self.iterations and not self.stop_reason:
            self.stop_reason = "iteration limit"
        self._note(losses)
        return True

    def losses(self) -> dict[str, float]:
        """Sums of squares where network, parameters and levels are now."""
        return self.equations.losses(self.point, self.noise)

    @property
    def model(self) -> NoiseModel:
        """The levels of the residuals."""
        return self.noise.records[0]

    def _settle(self, solved: SolvedStep, after: Mapping[str, float]) -> bool:
        """Have the levels follow residuals, weights and parameters (MacKay 1992).

        Returns:
            Whether they stay where they are.
        """
        equations, forces = self.equations, solved.forces
        kept = solved.system.kept(self.iteration)
        free = max(float(kept[forces].sum()), 1.0)
        excess, promised = after["forces"] / free, float(solved.residual[forces].square().sum()) / free
        # Forces that the next step will balance say nothing against the model.
        excess = max(1.0, promised) if excess > 1.0 else excess
        # A discrepancy that is too large is squared down rather than rooted: the residuals shrink with it.
        change = np.clip(excess if excess < 1.0 else np.sqrt(excess), LARGEST_FALL, LARGEST_RISE)
        before, level = self.noise, self.model.discrepancy * float(change)
        noise = replace(self.model, discrepancy=max(level, self._finest))
        spread = self._spread(solved, is_far=level > SUSPICIOUS_DISCREPANCY * self.largest)
        self.noise = NoiseLevels((noise,), spread)
        unknowns = len(kept) - float(kept.sum())
        growth = float(np.clip(unknowns / max(after["weights"], 1e-12), LARGEST_FALL, 1.0 / LARGEST_FALL))
        equations.precision *= growth
        changes = np.abs(np.log([growth, noise.discrepancy / before.discrepancy, spread / before.spread]))
        return bool(changes[:2].max() < LEVEL_TOLERANCE and changes[2] < SPREAD_TOLERANCE)

    def _spread(self, solved: SolvedStep, is_far: bool) -> float:
        """How far believed parameters are off, in common; ``is_far``: whether the search is far from its end."""
        believed, before = ~self.equations.frame.unknown, self.noise.spread
        if not self.learn_spread or not bool(believed.any()):
            return before
        x = self.point.parameters[believed].cpu().numpy()
        variance = before**2 * solved.system.parameter_covariance.diagonal()[believed].cpu().numpy()
        change = updated_spread(x, variance, before) / before
        # Parameters that hardly move from where they are believed to be let their spread fall a little at a time.
        spread = before * max(change**2 if change < 1.0 else change, LARGEST_FALL)
        # How far off a search has the parameters that is far from its end says nothing about how far off they are.
        return min(spread, max(1.0, before)) if is_far else spread

    @property
    def _finest(self) -> float:
        """The least discrepancy that is looked for, N."""
        measured = self.model.force[np.isfinite(self.model.force)]
        of_noise = FINEST_OF_LOAD_CELL * float(measured.min()) if measured.size else 0.0
        return max(FINEST_OF_FORCE * self.largest, of_noise)

    def _note(self, losses: Mapping[str, float]) -> None:
        weights = {**noise_weights(self.model), "weights": self.equations.precision}
        self.history.add(self.iteration, losses, weights)

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`Stepwise.state_dict`; what training began with is the settings' and the seed's."""
        return {
            "iteration": self.iteration,
            "idle": self.idle,
            "stop_reason": self.stop_reason,
            "damping": self.damping,
            "precision": self.equations.precision,
            "dense": self.equations.dense,
            "discrepancy": self.noise.discrepancy,
            "spread": self.noise.spread,
            "weights": self.point.unknowns,
            "parameters": self.point.parameters,
            "history": self.history.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`Stepwise.load_state_dict`."""
        self.iteration, self.idle, self.stop_reason = state["iteration"], state["idle"], state["stop_reason"]
        self.damping, self.equations.precision = state["damping"], state["precision"]
        self.equations.dense = state["dense"]
        self.noise = NoiseLevels((replace(self.model, discrepancy=state["discrepancy"]),), state["spread"])
        like = self.point.parameters
        self.point = Point(*(torch.as_tensor(state[name]).to(like) for name in ("weights", "parameters")))
        self.history.load_state_dict(state["history"])
