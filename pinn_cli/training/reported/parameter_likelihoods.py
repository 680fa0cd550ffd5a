"""From a trained network to likelihoods of its unknown parameters: all that a sampler needs, in small matrices.

One is given the network's motion, as if that were exact (the paper's). The other has the motion integrated out: how
well the states are known is part of it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import torch

from pinn_cli.record.record import Record
from pinn_cli.system.functions import Jet
from pinn_cli.training.covariance import ReadoutPosterior
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.least_squares import LeastSquares
from pinn_cli.training.levels import force_noise_statistics
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution

# Half-width of the tabulated range of s, in its standard deviations and at most, and the number of points in it:
# parameters follow s smoothly, and little.
S_RANGE, S_REACH, S_POINTS = 6.0, 0.6, 5


@dataclass(frozen=True, eq=False)
class ParameterLikelihoods:
    """Both likelihoods, and what they say about the force.

    Attributes:
        marginal: The motion integrated out.
        conditional: The motion held at the most probable one.
        force: (N, n), N, what the most probable motion takes, at the parameters' ``peak``; empty where no equation of
            motion has a measured force.
        force_by_parameter: (N, n, p), its change with the parameters, the motion following them.
    """

    marginal: MarginalLikelihood
    conditional: ConditionalLikelihood
    force: np.ndarray
    force_by_parameter: np.ndarray


def parameter_likelihoods(evidence: Evidence, trained: Trained) -> ParameterLikelihoods:
    """Both likelihoods of the unknown parameters about a trained network, or about those of several records.

    What they say about the force is that of the first record.
    """
    equations = evidence.equations
    marginal = marginal_likelihood(evidence, trained)
    point, scale = trained.solution.point.parameters.numpy(), equations.scale
    moved, slope = np.zeros((0, 0)), np.zeros((0, 0, len(scale)))
    if np.isfinite(marginal.sigma_force).any():
        force, record_slope = evidence.each_record(force_of_motion, trained)[0]
        slope = np.zeros((*record_slope.shape[:2], len(scale)))
        slope[..., equations.columns[0]] = record_slope
        moved = force + slope @ (marginal.peak - _physical(equations, point))
    return ParameterLikelihoods(marginal, conditional_likelihood(evidence, trained), moved, slope)


def force_of_motion(evidence: RecordEvidence, solution: RecordSolution) -> tuple[np.ndarray, np.ndarray]:
    """(N, n) force that the most probable motion of one record takes, and (N, n, p) its change with the parameters."""
    equations = evidence.equations
    posterior = ReadoutPosterior(equations, solution.point, solution.factor)
    slope = posterior.force_by_parameter(equations.forces).numpy() / equations.scale.numpy()
    states = equations.flat_states(equations.forces, solution.point)
    force = equations.dynamics.external_force(Jet(*states[:3]), equations.parameters(solution.point))
    return force.numpy(), slope


def marginal_likelihood(evidence: Evidence, trained: Trained) -> MarginalLikelihood:
    """The marginal likelihood, tabulated over the scale of the force noise; each point is a solution of its own.

    The noise of the force sensors of all records has one scale; its standard deviations are those of the first. Its
    logarithm s is a Gaussian, as wide as the values that tell it say; parameters under it are another.
    """
    record = evidence.records[0].problem.record
    names = tuple(p.name for p in evidence.equations.uncertain)
    sigma = trained.noise.records[0].force[: record.ndof] * np.sqrt(_repeats(record))
    squares, values = np.sum(evidence.each_record(force_noise_statistics, trained), axis=0)
    s_mean, s_std = (0.5 * np.log(squares / values), 1.0 / np.sqrt(2.0 * values)) if values > 0.0 else (0.0, 1.0)
    reach = min(S_RANGE * s_std, S_REACH) if values > 0.0 else 0.0
    rows = []
    for s in np.linspace(-reach, reach, S_POINTS if reach else 1):
        louder = trained.noise.each(NoiseModel.with_force_scale, float(np.exp(s)))
        retrained = evidence.train(louder, trained.solution.point) or trained
        # With the parameters integrated out again, s is the Gaussian.
        level = 0.5 * (retrained.factor.parameter_log_determinant - trained.factor.parameter_log_determinant)
        rows.append((s, level, *_without_prior(evidence.equations, retrained)))
    nodes, levels, peaks, precisions = (np.array(values) for values in zip(*rows, strict=True))
    return MarginalLikelihood(names, sigma, nodes, levels, peaks, precisions, (float(s_mean), float(s_std)))


def _repeats(record: Record) -> int:
    return 1 if record.repeats is None else record.repeats.count


def _without_prior(equations: LeastSquares, trained: Trained) -> tuple[np.ndarray, np.ndarray]:
    """Peak (p,) and precision (p, p) of the likelihood alone, in the parameters' units.

    Gauss-Newton worked under wide Gaussians, which the sampler replaces by the user's priors.
    """
    _, step = trained.factor.step(equations.assemble(trained.solution.point, trained.noise))
    prior = np.diag(equations.precision(trained.noise).numpy())
    posterior = np.linalg.inv(trained.factor.corner_covariance)
    values, vectors = np.linalg.eigh(posterior - prior)
    # What the record does not determine at all must not come out negative by rounding.
    values = np.maximum(values, 1e-12 * values.max())
    precision = (vectors * values) @ vectors.T
    moved = trained.solution.point.parameters.numpy() + step
    peak = np.linalg.solve(precision, posterior @ moved)
    scale = equations.scale
    return _physical(equations, peak), precision / np.outer(scale, scale)


def _physical(equations: LeastSquares, x: np.ndarray) -> np.ndarray:
    """(p,) parameters in their own units."""
    start = np.array([p.prescribed for p in equations.uncertain])
    return start + equations.scale * x


def conditional_likelihood(evidence: Evidence, trained: Trained) -> ConditionalLikelihood:
    """The conditional likelihood at the most probable motion, of every DOF whose equation of motion is enforced."""
    equations = evidence.equations
    p = len(equations.uncertain)
    gram, moment, square, scatter, count = np.zeros((p, p)), np.zeros(p), 0.0, 0.0, 0
    of_records = zip(equations.columns, evidence.each_record(force_regression, trained), strict=True)
    for columns, (own_gram, own_moment, own_square, own_scatter, own_count) in of_records:
        gram[np.ix_(columns, columns)] += own_gram
        moment[columns] += own_moment
        square, scatter, count = square + own_square, scatter + own_scatter, count + own_count
    moved = -np.linalg.lstsq(gram, moment, rcond=None)[0]
    peak = _physical(equations, trained.solution.point.parameters.numpy()) + moved
    names = tuple(q.name for q in equations.uncertain)
    forced = evidence.records[0].problem.record.sensors("force")
    return ConditionalLikelihood(names, forced, gram, peak, square + float(moment @ moved) + scatter, count)


def force_regression(
    evidence: RecordEvidence, solution: RecordSolution
) -> tuple[np.ndarray, np.ndarray, float, float, int]:
    """Sums over the samples of one record, repeats included, of its force residual and of the residual's derivatives.

    Returns:
        (p, p) derivatives times derivatives; (p,) derivatives times residual; squares of the residual; squares of the
        force's repeats about their mean; how many residuals there are.
    """
    equations, record, point = evidence.equations, evidence.problem.record, solution.point
    at_samples = slice(None, None, equations.refinement)
    residual = equations.physics.scatter(equations.motion.force(point))[at_samples]
    rows = equations.motion.rows(equations.forces, point)
    p = len(equations.uncertain)
    gram, moment = np.zeros((p, p)), np.zeros(p)
    for dof in torch.nonzero(equations.target.equation).flatten().tolist():
        grouped = equations.pattern.uncertain_columns(rows.parameter[:, :, dof], dof)
        columns = (equations.forces.scatter(grouped) / equations.scale).numpy()  # (N, p), N per unit
        gram += columns.T @ columns
        moment += columns.T @ residual[:, dof].numpy()
    repeats = _repeats(record)
    scatter = 0.0 if record.repeats is None else float(record.repeats.square["force"][record.sensors("force")].sum())
    count = repeats * len(record.time) * int(equations.target.equation.sum())
    return repeats * gram, repeats * moment, repeats * float(residual.square().sum()), scatter, count


class ParameterLikelihood(ABC):
    """log p(record | theta, s), of the unknown parameters theta (p,) and the logarithm s of the force noise's scale.

    The standard deviation of the force that is measured on DOF i is ``sigma_force[i] * exp(s)``. A call costs O(p^2),
    whatever the length of the record.

    Attributes:
        names: The p parameters, ``c_1``, ``k_2``, ..., in the order of theta; SI units.
        sigma_force: (n,) N, at s = 0; NaN where there is no force sensor.
        peak: (p,), the theta of highest likelihood at s = 0.
        curvature: (p, p), minus the Hessian there.
        s_std: Standard deviation of s, order of magnitude.
    """

    names: tuple[str, ...]
    sigma_force: np.ndarray
    peak: np.ndarray
    curvature: np.ndarray
    s_std: float

    @abstractmethod
    def evaluate(self, theta: np.ndarray, s: float) -> tuple[float, np.ndarray, float]:
        """Logarithm of the likelihood up to a constant, its gradient by theta (p,) and its derivative by s."""


class MarginalLikelihood(ParameterLikelihood):
    """log p(record | theta, s) = level(s) - away^T precision(s) away / 2 + log N(s), with away = theta - peak(s).

    The readout weights are integrated out by Laplace's method about the most probable motion: the precision is the
    Schur complement of the joint Gauss-Newton Hessian. Level, peak and the precision's Cholesky factor are polynomials
    through their values at a few s, and beyond those what they are at the nearest: of a precision that hardly holds
    some direction, polynomials through the entries themselves are indefinite between two s. N is what the residuals
    say of the noise by themselves.

    Args:
        names: See :class:`ParameterLikelihood`.
        sigma_force: Likewise.
        s: (G,), about 0; a single one where no force is measured, and nothing depends on s.
        level: (G,).
        peak: (G, p).
        precision: (G, p, p), symmetric, positive.
        s_told: Mean and standard deviation of N, a Gaussian.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        sigma_force: np.ndarray,
        s: np.ndarray,
        level: np.ndarray,
        peak: np.ndarray,
        precision: np.ndarray,
        s_told: tuple[float, float],
    ) -> None:
        self.names, self.sigma_force = names, sigma_force
        self.s_mean, self.s_std = s_told
        self.reach = float(np.max(np.abs(s))) or 1.0
        powers = np.vander(s / self.reach, increasing=True)
        solve = np.linalg.inv(powers)
        self._level, self._peak = solve @ level, solve @ peak
        self._root = np.tensordot(solve, np.linalg.cholesky(precision).swapaxes(1, 2), 1)
        self.peak, self.curvature = self._peak[0], self._root[0].T @ self._root[0]

    def evaluate(self, theta: np.ndarray, s: float) -> tuple[float, np.ndarray, float]:
        """See :meth:`ParameterLikelihood.evaluate`."""
        within = min(max(s, -self.reach), self.reach)
        inside = within / self.reach
        order = np.arange(len(self._level))
        powers = inside**order
        slopes = order * inside ** np.maximum(order - 1, 0) / self.reach
        away = theta - powers @ self._peak
        root = np.tensordot(powers, self._root, 1)
        deviations = root @ away
        pull = root.T @ deviations
        value = float(powers @ self._level - 0.5 * deviations @ deviations)
        turn = np.tensordot(slopes, self._root, 1) @ away
        by_s = float(slopes @ self._level + pull @ (slopes @ self._peak) - deviations @ turn)
        if s != within:
            by_s = 0.0
        if len(order) > 1:
            off = (s - self.s_mean) / self.s_std
            value, by_s = value - 0.5 * off**2, by_s - off / self.s_std
        return value, -pull, by_s


class ConditionalLikelihood(ParameterLikelihood):
    """The paper's eq. for p(f* | theta_s, theta_n): independent Gaussian residuals of one standard deviation.

    The residual is linear in the parameters, so its sum of squares is a quadratic of precomputed matrices,
    square(theta) = least + (theta - peak)^T gram (theta - peak).

    The states' own uncertainty is left out. Over 40 records the 90 % intervals of such posteriors covered the truth in
    36 to 50 % of all cases.

    Args:
        names: See :class:`ParameterLikelihood`.
        forced: (n,) bool, DOFs whose force is measured.
        gram: (p, p), sum over samples and DOFs of products of the residual's derivatives.
        peak: (p,), least squares.
        least: Sum of squares there, scatter of repeats included, N^2.
        count: Number of residuals, repeats included.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        forced: np.ndarray,
        gram: np.ndarray,
        peak: np.ndarray,
        least: float,
        count: int,
    ) -> None:
        self.names, self.peak, self.count = names, peak, count
        self.variance = least / count
        self.sigma_force = np.where(forced, np.sqrt(self.variance), np.nan)
        self.curvature = gram / self.variance
        self.s_std = float(1.0 / np.sqrt(2.0 * count))

    def evaluate(self, theta: np.ndarray, s: float) -> tuple[float, np.ndarray, float]:
        """See :meth:`ParameterLikelihood.evaluate`."""
        away = theta - self.peak
        shrink = float(np.exp(-2.0 * s))
        pull = shrink * (self.curvature @ away)
        square = self.count * shrink + float(away @ pull)
        return -0.5 * square - self.count * s, -pull, square - self.count
