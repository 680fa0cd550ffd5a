"""From a trained network to likelihoods of its unknown parameters: all that a sampler needs, in small matrices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from pinn_cli.system.functions import Jet
from pinn_cli.training.band.discrepancy_search import Trained
from pinn_cli.training.band.evidence import Evidence
from pinn_cli.training.band.normal_equations import NormalEquations
from pinn_cli.training.band.posterior import ReadoutPosterior
from pinn_cli.training.conditional_likelihood import ConditionalLikelihood
from pinn_cli.training.marginal_likelihood import S_POINTS, S_RANGE, MarginalLikelihood


@dataclass(frozen=True, eq=False)
class ParameterLikelihoods:
    """Both likelihoods, and what they say about the force.

    Attributes:
        marginal: The motion integrated out.
        conditional: The motion held at the most probable one.
        force: (N, n), N, what the most probable motion takes, at the parameters' ``peak``.
        force_by_parameter: (N, n, p), its change with the parameters, the motion following them.
    """

    marginal: MarginalLikelihood
    conditional: ConditionalLikelihood
    force: np.ndarray
    force_by_parameter: np.ndarray


def parameter_likelihoods(evidence: Evidence, trained: Trained) -> ParameterLikelihoods:
    """Both likelihoods of the unknown parameters about a trained network."""
    equations = evidence.equations
    marginal = marginal_likelihood(evidence, trained)
    posterior = ReadoutPosterior(equations, trained.solution.point, trained.factor)
    slope = posterior.force_by_parameter(equations.forces).numpy() / equations.scale.cpu().numpy()
    states = equations.flat_states(equations.forces, trained.solution.point)
    parameters = equations.parameters(trained.solution.point)
    force = equations.dynamics.external_force(Jet(*states[:3]), parameters)
    found = np.array([float(parameters[p.kind][p.index]) for p in equations.problem.uncertain])
    moved = force.cpu().numpy() + slope @ (marginal.peak - found)
    return ParameterLikelihoods(marginal, conditional_likelihood(equations, trained), moved, slope)


def marginal_likelihood(evidence: Evidence, trained: Trained) -> MarginalLikelihood:
    """The marginal likelihood, tabulated over the scale of the force noise; each point is a solution of its own."""
    equations, record = evidence.equations, evidence.equations.problem.record
    names = tuple(p.name for p in equations.problem.uncertain)
    forced = record.sensors("force")
    repeats = 1 if record.repeats is None else record.repeats.count
    sigma = np.where(forced, trained.noise.force[: len(forced)] * np.sqrt(repeats), np.nan)
    samples = int(forced.sum()) * len(record.time) * repeats
    s_std = 1.0 / np.sqrt(2.0 * samples) if samples else 1.0
    nodes = np.linspace(-1.0, 1.0, S_POINTS) * S_RANGE * s_std if samples else np.zeros(1)
    rows = []
    for s in nodes:
        noise = trained.noise.with_force_scale(float(np.exp(s)))
        found = evidence.train(noise, trained.solution.point) or trained
        rows.append((_level(evidence, found, float(s)), *_without_prior(equations, found)))
    level, peak, precision = (np.array(values) for values in zip(*rows, strict=True))
    return MarginalLikelihood(names, sigma, nodes, level, peak, precision, s_std)


def _level(evidence: Evidence, trained: Trained, s: float) -> float:
    """Logarithm of the likelihood at its peak with the readout integrated out, up to a constant in s.

    As in :class:`Evidence`, the discrepancy is among what the features can see of the residual. The rest of the force
    sensors' noise, and the scatter of repeats, tell that noise alone.
    """
    equations, noise, record = evidence.equations, trained.noise, evidence.equations.problem.record
    losses = equations.losses(trained.solution.point, noise)
    total = evidence.force_residuals(trained.solution.point, noise).misfit(noise)
    total += sum(value for name, value in losses.items() if name not in ("physics", "observer", "prior"))
    total += trained.factor.readout_log_determinant
    if record.repeats is not None:
        forced = record.sensors("force")
        scatter = record.repeats.square["force"][forced] / (
            record.repeats.count * noise.force[: len(forced)][forced] ** 2
        )
        total += float(scatter.sum() + 2.0 * record.repeats.freedom * int(forced.sum()) * s)
    return -0.5 * total


def _without_prior(equations: NormalEquations, trained: Trained) -> tuple[np.ndarray, np.ndarray]:
    """Peak (p,) and precision (p, p) of the likelihood alone, in the parameters' units.

    Gauss-Newton worked under wide Gaussians, which the sampler replaces by the user's priors.
    """
    system = equations.assemble(trained.solution.point, trained.noise)
    _, step = trained.factor.step(system)
    prior = np.diag(equations.precision(trained.noise).cpu().numpy())
    posterior = np.linalg.inv(trained.factor.corner_covariance)
    values, vectors = np.linalg.eigh(posterior - prior)
    # What the record does not determine at all must not come out negative by rounding.
    values = np.maximum(values, 1e-12 * values.max())
    precision = (vectors * values) @ vectors.T
    moved = trained.solution.point.parameters.cpu().numpy() + step
    peak = np.linalg.solve(precision, posterior @ moved)
    scale = equations.scale.cpu().numpy()
    start = np.array([p.prescribed for p in equations.problem.uncertain])
    return start + scale * peak, precision / np.outer(scale, scale)


def conditional_likelihood(equations: NormalEquations, trained: Trained) -> ConditionalLikelihood:
    """The conditional likelihood at the most probable motion, of every DOF whose equation of motion is enforced."""
    record, point = equations.problem.record, trained.solution.point
    at_samples = slice(None, None, equations.refinement)
    residual = equations.physics.scatter(equations.force_residual(point))[at_samples]
    rows = equations.rows(equations.forces, point)
    p = len(equations.problem.uncertain)
    gram, moment = np.zeros((p, p)), np.zeros(p)
    for dof in torch.nonzero(equations.target.equation).flatten().tolist():
        grouped = equations.pattern.uncertain_columns(rows.parameter[:, :, dof], dof)
        columns = (equations.forces.scatter(grouped) / equations.scale).cpu().numpy()  # (N, p), N per unit
        gram += columns.T @ columns
        moment += columns.T @ residual[:, dof].cpu().numpy()
    moved = -np.linalg.lstsq(gram, moment, rcond=None)[0]
    least = float(residual.square().sum()) + float(moment @ moved)
    repeats, scatter = 1, 0.0
    if record.repeats is not None:
        repeats = record.repeats.count
        scatter = float(record.repeats.square["force"][record.sensors("force")].sum())
    count = repeats * len(record.time) * int(equations.target.equation.sum())
    start = np.array([q.prescribed for q in equations.problem.uncertain])
    peak = start + equations.scale.cpu().numpy() * point.parameters.cpu().numpy() + moved
    names = tuple(q.name for q in equations.problem.uncertain)
    return ConditionalLikelihood(names, record.sensors("force"), repeats * gram, peak, repeats * least + scatter, count)
