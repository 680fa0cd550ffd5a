"""Estimates, standard deviations and intervals of the parameters, with the motion integrated out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pinn_cli.model.knowledge import ParameterKnowledge
from pinn_cli.model.truncated_gaussian import TruncatedGaussian
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.quantities import INITIAL_STATE
from pinn_cli.training.estimate import ParameterEstimate
from pinn_cli.training.evidence import Trained
from pinn_cli.training.least_squares import LeastSquares
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution

# N; a model without any misfit is divided by it.
LEAST_MISFIT = 1e-300
# Force over misfit beyond which nothing is hidden; its square is still a number in any unit.
LARGEST_CONTRAST = 1e100


def parameter_posterior(
    equations: LeastSquares,
    trained: Trained,
    hidden: tuple[np.ndarray, np.ndarray],
    covariance: np.ndarray | None = None,
) -> tuple[list[ParameterEstimate], np.ndarray, ParameterKnowledge]:
    """Every uncertain parameter, the (p, p) correlation of all of them, and what is known without bounds.

    The posterior is the Gaussian of the joint Hessian with the readout weights marginalised, of which parameters that
    cannot be negative leave only a part. Where a bound holds one back, the Gaussian's own peak lies beyond the bound,
    at a Newton step's distance from the solution. What misfit may have added to each comes on top. Which of them is
    the estimate: :func:`pinn_cli.training.reported.parameter_posterior.bounded_estimates`.

    Args:
        equations: Of one record or of several.
        trained: Their solution.
        hidden: Both (p,), see :func:`coherent_misfit`.
        covariance: (p, p), of that Gaussian; None: by the Hessian.
    """
    mode, scale, step = trained.solution.point.parameters.numpy(), equations.scale, np.zeros(len(equations.scale))
    if (mode <= equations.lower).any():
        step = trained.factor.step(equations.assemble(trained.solution.point, trained.noise))[1]
    peak = mode + step
    covariance = trained.factor.corner_covariance if covariance is None else covariance
    # What follows is about parameters alone: a first state is integrated out.
    uncertain, lower = [p for p in equations.uncertain if p.kind != INITIAL_STATE], equations.lower
    kept = slice(len(uncertain))
    mode, scale, peak, covariance, lower = mode[kept], scale[kept], peak[kept], covariance[kept, kept], lower[kept]
    known = ParameterKnowledge(
        np.array([p.prescribed for p in uncertain]) + scale * peak,
        covariance * np.outer(scale, scale),
        hidden[0][kept] / scale,
        hidden[1][kept] / scale**2,
        scale,
        np.where(equations.unknown, np.nan, [p.prescribed for p in equations.uncertain]),
        trained.noise.spread,
    )
    prior = equations.by_record[0].problem.prior
    if prior is not None:
        earlier_misfit = trained.noise.records[0].earlier_misfit
        known = replace(
            known,
            told=known.told + earlier_misfit * prior.told,
            weight=known.weight + earlier_misfit**2 * prior.weight,
            first_std=prior.first_std,
            prescribed=prior.prescribed,
            spread=prior.spread,
        )
    misfit = known.hidden / scale
    posterior = TruncatedGaussian(peak, covariance, lower)
    estimates = bounded_estimates(uncertain, scale, mode, posterior, misfit)
    whole = posterior.covariance + np.diag(misfit**2)
    unit = np.sqrt(np.diag(whole))
    return estimates, whole / np.outer(unit, unit), known


def coherent_misfit(
    columns: Sequence[np.ndarray], ratios: Sequence[tuple[np.ndarray, int]]
) -> tuple[np.ndarray, np.ndarray]:
    """What tells how much of what the model leaves out each parameter may have taken in: its sums over the records.

    The Hessian takes the discrepancy for noise, which averages out over a record. A force that was forgotten does not:
    that of a cubic spring follows the motion as that of a linear one does, and however long the record is, the linear
    one comes out stiffer. So a discrepancy of root mean square d may hide d / rms(dr/dx) of a parameter x whose force
    on its connections is r, or what the prior lets it hide. Without model error d is small, and this with it.

    It does not average out over records either, each of which hides as much as its weight among them: the first sum
    (p,) over the second is the standard deviation of what is hidden, in prior ones. See
    :class:`pinn_cli.model.knowledge.ParameterKnowledge`, which limits it to what the prior lets it hide.

    Args:
        columns: Of every record, the places of its parameters among all p.
        ratios: Of every record, see :func:`parameter_force`.
    """
    size = 1 + max((int(c.max()) for c in columns if len(c)), default=-1)
    weighed, weights = np.zeros(size), np.zeros(size)
    for places, (ratio, values) in zip(columns, ratios, strict=True):
        limited = np.minimum(ratio, LARGEST_CONTRAST)
        weighed[places] += values * limited
        weights[places] += values * limited**2
    return weighed, weights


def parameter_force(evidence: RecordEvidence, solution: RecordSolution) -> tuple[np.ndarray, int]:
    """(p,), rms force of a prior standard deviation of each parameter over that of the misfit; how many values tell."""
    equations = evidence.equations
    if not equations.vector.kinds:
        return np.zeros(0), 0
    segments, total = equations.physics, np.zeros(equations.vector.places)
    for part in equations.windows(segments):
        per_std = equations.motion.own_by_parameter(segments, solution.point, part)
        total = total + (per_std.square() * segments.mask[part, :, None]).sum((0, 1)).numpy()
    force = np.sqrt(total / segments.samples)[equations.vector.column]
    misfit = solution.noise.misfit(equations.network.count, len(equations.problem.record.time))
    if equations.problem.spectral is not None:  # what spectra say holds what the model leaves out already
        misfit = 0.0
    return force / max(misfit, LEAST_MISFIT), equations.network.count


# Ends of the central 90 % interval as probabilities.
CENTRAL_90 = (0.05, 0.95)
# Posterior standard deviations between mode and mean from which a bound counts: it then lies less than 2.8 of them
# below the mode.
NOTICEABLE = 0.01


def bounded_estimates(
    uncertain: Sequence[Parameter],
    unit: np.ndarray,
    mode: np.ndarray,
    posterior: TruncatedGaussian,
    misfit: np.ndarray | float = 0.0,
) -> list[ParameterEstimate]:
    """Every uncertain parameter with its standard deviation and central 90 % interval.

    The estimate is the mode, where a Gaussian has its mean. Where a bound cuts noticeably into the posterior of any
    parameter, the estimates of all are means: the mode of what is left may be the bound itself, outside the interval,
    and the others' intervals follow from where the mean is.

    Args:
        uncertain: p parameters; all that follows is counted from their prescribed values.
        unit: (p,), of what follows, in the parameter's own.
        mode: (p,), the most probable values.
        posterior: Given their bounds.
        misfit: (p,), standard deviation of what else each may be off by.
    """
    marginals = posterior.marginals(CENTRAL_90, misfit)
    held = mode <= posterior.lower
    cut = bool(np.any(np.abs(marginals.mean - mode) > NOTICEABLE * marginals.std))
    distance = unit * marginals.mean if cut else np.where(held, [p.lower for p in uncertain], unit * mode)
    std, (lower, upper) = unit * marginals.std, unit * marginals.quantiles
    return [
        ParameterEstimate(p, p.value(distance[i]), float(std[i]), p.value(lower[i]), p.value(upper[i]), bool(held[i]))
        for i, p in enumerate(uncertain)
    ]
