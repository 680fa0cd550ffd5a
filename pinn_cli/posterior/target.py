"""The posterior density in the coordinates that a sampler likes: unconstrained, uncorrelated, of unit width."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from pinn_cli.posterior.posterior import PosteriorSamples
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.priors import Prior, stacked
from pinn_cli.training.reported.parameter_likelihoods import ParameterLikelihood

# Standard deviation of the prior of s. The noise's scale has Jeffreys' prior, flat in its logarithm, over a range that
# nobody will miss (a factor of exp(10) either way); without any end a record without a force sensor leaves s nowhere.
S_STD = 10.0
# A positive parameter whose likelihood peaks at or below zero starts this many standard deviations above it.
ABOVE_ZERO = 0.1
# A parameter within so many standard deviations of zero may be there: its transform bends.
NEAR_ZERO = 6.0
# Slope of the log density by a parameter in its scale at which the search for the mode ends; draws differ by order 1.
LEVEL = 1e-7
# Curvature along a direction that the density does not care about, relative to the others'.
FLAT_DIRECTION = 1e-10

# x (d,) to the logarithm of a density and its gradient (d,).
LogDensity = Callable[[np.ndarray], tuple[float, np.ndarray]]


class Target:
    """log p(theta, s | record) up to a constant, and the way there from coordinates q of about N(0, I).

    ``x`` (p + 1,) are the unconstrained coordinates: theta_j itself, or what :class:`Softplus` makes of it where its
    prior is positive, and last s. The density is that of x, so it contains the transform's Jacobian. The whitened
    coordinates are q (p + 1,); see :class:`Whitening`.

    Args:
        likelihood: Of the p parameters.
        priors: (p,), in the likelihood's order.

    Raises:
        DivergenceError: The density cannot be evaluated where the search for the mode starts.
    """

    def __init__(self, likelihood: ParameterLikelihood, priors: Sequence[Prior]) -> None:
        self.likelihood, self.priors = likelihood, tuple(priors)
        self.groups = stacked(self.priors)
        self.force_dofs = np.flatnonzero(np.isfinite(likelihood.sigma_force))
        self.positive = np.flatnonzero([prior.positive for prior in self.priors])
        self.width = _width(likelihood.curvature, np.array([prior.std for prior in self.priors]))
        self.softplus = Softplus(self.width[self.positive])
        with np.errstate(all="ignore"):
            self.mode, self.precision = find_mode(self.log_density, *self._start())
            from_zero = (self.parameters(self.mode) / self.width)[self.positive]
            by_distance = np.argsort(from_zero, kind="stable")
            near = self.positive[by_distance[from_zero[by_distance] < NEAR_ZERO]]
            self.whitening = Whitening(self.mode, self.precision, near, Softplus(self.width[near]))

    @property
    def size(self) -> int:
        """Number of coordinates, p + 1."""
        return len(self.priors) + 1

    def log_density(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Value and gradient (p + 1,) at x; minus infinity where the likelihood has no value."""
        theta, s = self.parameters(x), float(x[-1])
        try:
            value, by_theta, by_s = self.likelihood.evaluate(theta, s)
        except np.linalg.LinAlgError:
            return -math.inf, np.zeros_like(x)
        slope = np.array(by_theta, dtype=float)
        for places, prior in self.groups:
            value += float(np.add.reduce(prior.log_density(theta[places])))
            slope[places] += prior.slope(theta[places])
        by_x, log_jacobian, bend = self.softplus.slopes(theta[self.positive])
        slope[self.positive] = slope[self.positive] * by_x + bend
        value += float(np.add.reduce(log_jacobian)) - 0.5 * (s / S_STD) ** 2
        gradient = np.append(slope, by_s - s / S_STD**2)
        return (float(value), gradient) if math.isfinite(value) else (-math.inf, np.zeros_like(x))

    def potential(self, q: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the logarithm of the density at q (p + 1,), and its gradient by q."""
        x = self.whitening.coordinates(q)
        value, by_x = self.log_density(x)
        return -value, -self.whitening.slope(x, by_x)

    def parameters(self, x: np.ndarray) -> np.ndarray:
        """Theta (..., p), SI units, of x (..., p + 1)."""
        theta = x[..., :-1].copy()
        theta[..., self.positive] = self.softplus.parameters(theta[..., self.positive])
        return theta

    def samples(
        self,
        method: str,
        x: np.ndarray,
        seed: int,
        seconds: np.ndarray,
        statistics: dict[str, np.ndarray] | None = None,
        warmup: int = 0,
    ) -> PosteriorSamples:
        """Parameters and noise at x (chains, draws, p + 1), with as many draws from the prior as of a chain."""
        sequences = np.random.SeedSequence([seed, 0]).spawn(len(self.priors))
        pairs = zip(self.priors, map(np.random.default_rng, sequences), strict=True)
        return PosteriorSamples(
            method=method,
            names=self.likelihood.names,
            draws=self.parameters(x),
            sigma_force=self.likelihood.sigma_force[self.force_dofs] * np.exp(x[..., -1:]),
            force_dofs=self.force_dofs + 1,
            prior=np.stack([prior.sample(generator, x.shape[1]) for prior, generator in pairs], axis=-1),
            statistics=statistics or {},
            warmup=warmup,
            seconds=seconds,
        )

    def _start(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the search for the mode starts, and how wide the density may be there, both in x (p + 1,)."""
        prior_mean = np.array([prior.mean for prior in self.priors])
        theta = np.where(np.isfinite(self.likelihood.peak), self.likelihood.peak, prior_mean)
        at = np.maximum(theta, ABOVE_ZERO * self.width)[self.positive]
        theta[self.positive] = self.softplus.coordinates(at)
        s_width = float(self.likelihood.s_std)
        s_width = min(s_width, S_STD) if math.isfinite(s_width) and s_width > 0 else 1.0
        return np.append(theta, 0.0), np.append(self.width, s_width)


def _width(curvature: np.ndarray, prior_std: np.ndarray) -> np.ndarray:
    """Standard deviations (p,) of the parameters under likelihood and prior, both taken for Gaussians."""
    with np.errstate(over="ignore"):  # of a prior whose tail is so heavy that it has none
        precision = curvature + np.diag(prior_std**-2.0)
    alone = np.sqrt(np.maximum(np.diag(curvature), 0) + prior_std**-2.0)
    values, vectors = np.linalg.eigh(precision / np.outer(alone, alone))
    together = np.sqrt(np.sum(vectors**2 / np.maximum(values, FLAT_DIRECTION), axis=1)) / alone
    return np.minimum(together, prior_std)


def find_mode(log_density: LogDensity, start: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Newton steps uphill in a region of trust.

    Args:
        log_density: The density.
        start: (d,), where it is finite.
        scale: (d,), order of magnitude of the density's width along each axis, the others held.

    Returns:
        The mode (d,), and minus the Hessian there (d, d), made positive definite.

    Raises:
        DivergenceError: The density is not finite at the start.
    """

    def descent(steps: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = log_density(start + scale * steps)
        return -value, -scale * gradient

    if not math.isfinite(descent(np.zeros_like(start))[0]):
        raise DivergenceError(
            f"the posterior cannot be evaluated at its start, {np.array2string(start, precision=4)} (logarithms of "
            "parameters that are positive, and of the noise): is a prior far from all that the record allows?"
        )
    optimum = optimize.minimize(
        descent,
        np.zeros_like(start),
        jac=True,
        hess=lambda steps: _curvature(log_density, start + scale * steps, scale) * np.outer(scale, scale),
        method="trust-exact",
        options={"gtol": LEVEL},
    )
    mode = start + scale * optimum.x
    return mode, _curvature(log_density, mode, scale)


def _curvature(log_density: LogDensity, x: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Minus the Hessian (d, d) by central differences of the gradient; negative eigenvalues are turned round."""
    steps = 1e-4 * scale
    rows = [
        (log_density(x - step)[1] - log_density(x + step)[1]) / (2 * size)
        for step, size in zip(np.diag(steps), steps, strict=True)
    ]
    scaled = np.array(rows) * np.outer(scale, scale)
    if not np.isfinite(scaled).all():
        return np.diag(1 / scale**2)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    values = np.maximum(np.abs(values), FLAT_DIRECTION * max(1.0, float(np.abs(values).max())))
    return (vectors * values) @ vectors.T / np.outer(scale, scale)


@dataclass(frozen=True, eq=False)
class Softplus:
    """theta = w log(1 + exp(x / w)), of several parameters at once: an exponential below w, a straight line above it.

    With w the width of the posterior of theta, a parameter that the record determines keeps its Gaussian likelihood
    and its linear correlations, and one that may be zero is spread over the logarithmic part. An exponential
    throughout bends both: of six parameters with relative standard deviations of 30 % and correlations of 0.99, NUTS
    then lost 5 % of its iterations to divergences.

    Attributes:
        width: (g,), w, in the parameters' units.
    """

    width: np.ndarray

    def parameters(self, x: np.ndarray) -> np.ndarray:
        """Theta (..., g) > 0 of x (..., g)."""
        return self.width * np.logaddexp(0.0, x / self.width)

    def coordinates(self, theta: np.ndarray) -> np.ndarray:
        """X (..., g) of theta (..., g) > 0."""
        return theta + self.width * np.log(-np.expm1(-theta / self.width))

    def slopes(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of theta (g,): d theta/dx, its logarithm, and the derivative of that by x."""
        decay = np.exp(-theta / self.width)
        by_x = -np.expm1(-theta / self.width)
        return by_x, np.log(by_x), decay / self.width


class Whitening:
    """x of q: white at the mode, and each other coordinate where it belongs when a parameter goes to zero.

    ``x = mode + L q`` would do for a Gaussian. But of a parameter theta that may be zero, x has a long tail in which
    theta hardly changes, and along which L would drag all that theta is correlated with; put right, that makes the
    tail 1 / (1 - correlation^2) times as stiff as the bulk, and chains stick in it. So the regression of what follows
    on such parameters is written on their theta, not on their x:

        x_j = mode_j + sum_{i < j} R_ji (theta_i - mode theta_i) / (d theta_i / d x_i at the mode) + D_j q_j

    for the ``near`` ones, in this order; for the rest likewise, with a Cholesky factor of their covariance given
    theta in place of D. The map is triangular and its determinant constant.

    Args:
        mode: (d,), x at the mode.
        precision: (d, d), minus the Hessian of the log density by x there.
        near: (a,), the coordinates whose parameters may be zero, the likeliest first.
        softplus: (a,), their theta of x.
    """

    def __init__(self, mode: np.ndarray, precision: np.ndarray, near: np.ndarray, softplus: Softplus) -> None:
        self.mode, self.near, self.softplus = mode, near, softplus
        self.rest = np.setdiff1d(np.arange(len(mode)), near)
        order = np.concatenate([near, self.rest])
        # Of the covariance: rows after one another, each given those before it.
        factor = np.linalg.cholesky(np.linalg.inv(precision[np.ix_(order, order)]))
        a = len(near)
        self.theta = softplus.parameters(mode[near])
        at_mode = softplus.slopes(self.theta)[0]
        self.scale = np.diag(factor)[:a].copy()
        self.regression = (np.eye(a) - np.linalg.inv(factor[:a, :a] / self.scale)) / at_mode
        self.rest_regression = factor[a:, :a] @ np.linalg.inv(factor[:a, :a]) / at_mode
        self.rest_factor = factor[a:, a:].copy()

    def coordinates(self, q: np.ndarray) -> np.ndarray:
        """X (..., d) of q (..., d): the ``near`` ones first in q, then the rest in order."""
        a, x = len(self.near), np.empty_like(q)
        rest, off = q[..., a:] @ self.rest_factor.T, np.empty_like(q[..., :a])  # theta off the mode's
        for j, place in enumerate(self.near):
            width = self.softplus.width[j]
            value = self.mode[place] + off[..., :j] @ self.regression[j, :j] + self.scale[j] * q[..., j]
            x[..., place] = value
            off[..., j] = width * np.logaddexp(0.0, value / width) - self.theta[j]
        if a:
            rest = rest + off @ self.rest_regression.T
        x[..., self.rest] = self.mode[self.rest] + rest
        return x

    def slope(self, x: np.ndarray, by_x: np.ndarray) -> np.ndarray:
        """A function's gradient by q (d,) at x (d,), from that by x (d,)."""
        a, by_rest = len(self.near), by_x[self.rest]
        by_q = np.empty_like(by_x)
        by_q[a:] = by_rest @ self.rest_factor
        if a:
            theta_by_x = self.softplus.slopes(self.softplus.parameters(x[self.near]))[0]
            total = by_x[self.near] + theta_by_x * (by_rest @ self.rest_regression)
            for j in range(a - 1, 0, -1):
                total[:j] += theta_by_x[:j] * self.regression[j, :j] * total[j]
            by_q[:a] = self.scale * total
        return by_q
