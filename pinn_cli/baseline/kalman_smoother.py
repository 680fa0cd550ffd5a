"""Iterated extended Rauch-Tung-Striebel smoother: what one would pick instead of a network."""

from __future__ import annotations

import numpy as np
import pandas as pd

from pinn_cli.baseline.channels import check_gauges
from pinn_cli.baseline.iterated_smoother import IteratedSmoother, Pass
from pinn_cli.baseline.noise_levels import most_probable, stiffened, widened
from pinn_cli.baseline.smoothed_estimate import smoothed_estimate
from pinn_cli.baseline.state_space import NoiseLevels, StateSpace
from pinn_cli.record.steps import has_stiff_law
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.settings.legal_values import fraction, positive_number, true_or_false, whole_number
from pinn_cli.system.parameters import FACTOR
from pinn_cli.training.base import Estimator
from pinn_cli.training.estimate import Estimate, RunContext


class KalmanSmoother(Estimator):
    """Smoothed states and parameters of the same model, from the same sensors (Sarkka 2013, chapter 10).

    Args:
        iterations: Passes at most under one noise level.
        tolerance: Part of the motion; a pass that moves it by less is the last.
        process_noise: Standard deviation of the force that the model leaves out, on every DOF, held from sample to
            sample, N; None: the most probable one, widened for its colour.
        learn_spread: Whether the common spread of the prescribed parameters is learned from the record.

    Raises:
        InputError: A setting outside its range.
    """

    name = "kalman_smoother"

    def __init__(
        self,
        iterations: int = 12,
        tolerance: float = 1e-4,
        process_noise: float | None = None,
        learn_spread: bool = True,
    ) -> None:
        self.iterations = whole_number("baseline.iterations", iterations, least=1)
        self.tolerance = fraction("baseline.tolerance", tolerance)
        self.learn_spread = true_or_false("baseline.learn_spread", learn_spread)
        self.process_noise = None if process_noise is None else positive_number("baseline.process_noise", process_noise)

    def check(self, problem: Problem) -> None:
        """See :meth:`Estimator.check`."""
        if has_stiff_law(problem.structure):
            hint = "the smoother takes explicit steps; a friction with a speed is possible"
            raise InputError("baseline", self.name, "none with friction that sticks", hint)
        if problem.inputs.ground or problem.structure.supports:
            hint = (
                "without a band the smoother copies the sensors of what they shake, and springs come out percents off"
            )
            raise InputError("baseline", self.name, "none where the ground or a support moves", hint)
        if problem.prior is not None:
            hint = "the smoother knows no correlated parameters"
            raise InputError("baseline", self.name, "none with model=...", hint)
        if any(p.kind == FACTOR for p in problem.uncertain):
            hint = "the coordinates of a finite-element model follow the factors, and the smoother's stay what they are"
            raise InputError("baseline", self.name, "none where factors of parts are in doubt", hint)
        check_gauges(problem.record, self.name)

    def solve(self, problem: JointProblem, run: RunContext) -> Estimate:
        """See :meth:`Estimator.solve`."""
        smoother = IteratedSmoother(StateSpace(problem.alone), self.iterations, self.learn_spread)
        try:
            last = self._last_pass(smoother, smoother.space.first_levels())
            summary = {
                "iterations": len(smoother.history),
                "stop_reason": "converged" if last.step < self.tolerance else "iteration limit",
                "log_evidence": last.log_evidence,
            }
            return smoothed_estimate(smoother.space, last, pd.DataFrame(smoother.history), summary)
        except (FloatingPointError, np.linalg.LinAlgError) as error:
            raise DivergenceError(str(error)) from error

    def _last_pass(self, smoother: IteratedSmoother, levels: NoiseLevels) -> Pass:
        """The solution under the given process noise, or under the one that is found."""
        if self.process_noise is None:
            best = widened(smoother, most_probable(smoother, levels))
        else:
            best = stiffened(smoother, levels, self.process_noise)
        return smoother.settle(best.trajectory, best.levels, self.tolerance)
