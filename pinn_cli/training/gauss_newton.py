"""Gauss-Newton training, with the loss weights inferred from the record.

A network with a linear readout is solved for its readout, one whose features are learned for all its weights, see
:func:`pinn_cli.training.function_space.training.solved_in_function_space`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.network import NetworkDesign
from pinn_cli.network.spline import Spline
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import fraction, positive_number, true_or_false, whole_number
from pinn_cli.system.basis import shares_basis
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.estimator import Training, built
from pinn_cli.training.function_space.training import MOST_RESIDUALS, solved_in_function_space
from pinn_cli.training.history import History
from pinn_cli.training.inference import infer
from pinn_cli.training.noise_model import NoiseLevels
from pinn_cli.training.record_scales import force_and_velocity_scale
from pinn_cli.training.reported.hand_over import handed_over
from pinn_cli.training.reported.parameter_likelihoods import parameter_likelihoods
from pinn_cli.training.reported.posterior_estimate import posterior_estimate
from pinn_cli.training.reported.stories import with_stories
from pinn_cli.training.solver import ITERATIONS, TOLERANCE, Inference, Solver, starting_noise
from pinn_cli.training.steps.known_levels import as_fine_as_before

FIXED_WEIGHTS = ("observation", "physics", "continuity")


class GaussNewton(Training):
    """Most probable readout and parameters, with weights that are noise levels.

    Args:
        iterations: Steps at most, under one noise model or of an MLP; None: ``ITERATIONS`` and 40.
        tolerance: Relative decrease of the loss below which that has converged; None: ``TOLERANCE`` and 0.02.
        weights: ``inferred`` (see :mod:`pinn_cli.training.noise_model`), or fixed loss weights lambda by
            ``observation``, ``physics`` and ``continuity`` on residuals that are scaled by the largest measured value
            of their kind, as in the paper; those of an MLP are always inferred.
        pooled: Whether the sensors of one quantity share one noise level; otherwise each has its own, as with an MLP.
        learn_spread: Whether the common spread of the prescribed parameters is learned from the record.
        collocation_points, most_residuals: Of an MLP, see
            :func:`pinn_cli.training.function_space.training.solved_in_function_space`.

    Raises:
        InputError: A setting outside its range.
    """

    def __init__(
        self,
        iterations: int | None = None,
        tolerance: float | None = None,
        weights: str | Mapping[str, float] = "inferred",
        learn_spread: bool = True,
        pooled: bool = False,
        collocation_points: int | None = None,
        most_residuals: int = MOST_RESIDUALS,
    ) -> None:
        self.iterations = None if iterations is None else whole_number("training.iterations", iterations, least=1)
        self.tolerance = None if tolerance is None else fraction("training.tolerance", tolerance)
        self.learn_spread = true_or_false("training.learn_spread", learn_spread)
        self.pooled = true_or_false("training.pooled", pooled)
        self.weights = _checked_weights(weights)
        self.collocation_points = collocation_points
        if collocation_points is not None:
            whole_number("training.collocation_points", collocation_points, least=2)
        self.most_residuals = whole_number("training.most_residuals", most_residuals, least=100)

    def solve(self, problem: JointProblem, design: NetworkDesign, run: RunContext) -> Estimate:
        """See :meth:`Training.solve`."""
        first = problem.first
        if problem.priors and self.weights:
            raise InputError("training.weights", self.weights, "inferred with scheme=bayesian", "they are noise levels")
        if problem.has_unknown_forces:
            design = design.within_band()
        elif problem.identifies:
            design = design.refined()
        network = built(design, first)
        if problem.is_informed and isinstance(network, LinearReadout):
            design = as_fine_as_before(design, first, network)
        if not isinstance(network, LinearReadout):
            return self._over_all_weights(problem, design, run)
        self._left_alone(design, "has a linear readout", collocation_points=None, most_residuals=MOST_RESIDUALS)
        history = History(run.progress, run.watch)
        limits = self.iterations or ITERATIONS, self.tolerance or TOLERANCE
        designs = (design,) * len(problem)
        solver = Solver(designs, history, *limits, self.learn_spread, self.pooled)
        with history:
            inference = self._weighed(problem, solver) if self.weights else infer(problem, solver)
            handed = None if first.hand_over is None else handed_over(inference)
        for equations, point in inference.by_record:
            equations.network.readout.data = equations.readout(point)
        estimate = posterior_estimate(inference.evidence, inference.trained, history)
        summary = estimate.summary | {
            "narrowed_by_refinement": inference.narrowed, "at_marginal_peak": inference.at_marginal_peak,
        }  # fmt: skip
        estimate = replace(estimate, summary=summary, rivals=inference.rivals, handed_over=handed)
        if not shares_basis(inference.evidence.problem.structure, problem.structure):
            estimate = replace(estimate, structure=inference.evidence.problem.structure)
        estimate = with_stories(inference, estimate)
        if not problem.priors:
            return estimate
        return replace(estimate, likelihoods=parameter_likelihoods(inference.evidence, inference.trained))

    def solves_inputs(self, design: NetworkDesign) -> bool:
        """See :meth:`Training.solves_inputs`."""
        return isinstance(design, Spline) and design.continuity == "exact" and not self.weights

    def gives_evidence(self, design: NetworkDesign) -> bool:
        """See :meth:`Training.gives_evidence`: weights that were fixed are no noise levels."""
        return not self.weights and design.name != "mlp"

    def solves_records(self, design: NetworkDesign) -> bool:
        """See :meth:`Training.solves_records`."""
        return not self.weights and design.name != "mlp"

    def _over_all_weights(self, problem: JointProblem, design: NetworkDesign, run: RunContext) -> Estimate:
        """Of a network whose features are learned too, in the space of its residuals."""
        if problem.priors:
            hint = "an MLP gives no likelihood of its parameters"
            raise InputError("network", design.name, "spline or fourier with scheme=bayesian", hint)
        self._left_alone(design, "has no linear readout", weights={}, pooled=False)
        limits = self.iterations, self.tolerance, self.learn_spread, self.collocation_points, self.most_residuals
        return solved_in_function_space(problem, design, run, *limits)

    def _left_alone(self, design: NetworkDesign, why: str, **unused: Any) -> None:
        """Refuse settings that a network has no use for, unless they have the given defaults."""
        for setting, default in unused.items():
            if getattr(self, setting) != default:
                hint = f"network={design.name} {why}"
                value = getattr(self, setting)
                raise InputError(f"training.{setting}", value, "left as it is, for this network", hint)

    def _weighed(self, problem: JointProblem, solver: Solver) -> Inference:
        """The solution under noise levels that weigh the residuals as lambdas do which the user has fixed."""
        evidence = solver.evidence(problem)
        force, velocity = force_and_velocity_scale(problem.alone)
        starting, record = starting_noise(evidence.equations.by_record[0]), problem.alone.record
        observation, physics, continuity = (self.weights[name] for name in FIXED_WEIGHTS)
        fixed = replace(
            starting,
            response={q: np.abs(getattr(record, q)).max(axis=0) / np.sqrt(observation) for q in RESPONSE_QUANTITIES},
            force=np.where(np.isnan(starting.force), np.nan, 0.0),
            discrepancy=force / np.sqrt(physics),
            continuity=velocity / np.sqrt(continuity),
        )
        noise = NoiseLevels((fixed,))
        trained = evidence.train(noise, evidence.equations.start())
        if trained is None:
            raise InputError(
                "training.weights", self.weights, "weights of less unequal size", "the normal matrix is singular"
            )
        return Inference(evidence, trained, solver)


def _checked_weights(weights: str | Mapping[str, float]) -> dict[str, float]:
    """Fixed loss weights by name, empty where they are to be inferred."""
    if weights == "inferred":
        return {}
    if not isinstance(weights, Mapping) or set(weights) != set(FIXED_WEIGHTS):
        given = dict(weights) if isinstance(weights, Mapping) else weights
        raise InputError("training.weights", given, f"inferred, or a number for each of {', '.join(FIXED_WEIGHTS)}")
    return {name: positive_number(f"training.weights.{name}", weights[name]) for name in FIXED_WEIGHTS}
