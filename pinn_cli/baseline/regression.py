"""The coefficients of a filtered time series: parameters and initial state, and how probable all of it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from pinn_cli.baseline.linear_gaussian import Filtered
from pinn_cli.training.parameter_spread import updated_spread

# The spread is a fixed point; a few parameters tell it to some tens of percent.
SPREAD_TOLERANCE, SPREAD_ROUNDS = 0.01, 30


@dataclass(frozen=True, eq=False)
class Regression:
    """Gaussian posterior of the coefficients of a filtered series.

    Attributes:
        change: (p,), posterior mean, from the point of linearisation.
        covariance: (p, p).
        precision: (p,), of their prior.
        spread: Prior standard deviation of those that share one.
        log_evidence: Logarithm of the probability density of the observations, up to a constant.
    """

    change: np.ndarray
    covariance: np.ndarray
    precision: np.ndarray
    spread: float
    log_evidence: float


def regress(
    filtered: Filtered,
    at: np.ndarray,
    spread: float,
    sharing: np.ndarray,
    pull: np.ndarray | float = 0.0,
    own: np.ndarray | float = 1.0,
) -> Regression:
    """Generalised least squares of the innovations on the coefficients.

    Args:
        filtered: Deviations from a trajectory.
        at: (p,), distance of the trajectory's coefficients from their prior mean, in prior standard deviations.
        spread: Factor on the prior standard deviation of some.
        sharing: (p,) bool, of which.
        pull: (p,), derivative of what the misfit lacks, see
            :meth:`pinn_cli.baseline.iterated_smoother.IteratedSmoother.pull_of_gains`.
        own: (p,), prior precision of those that share none.

    Raises:
        numpy.linalg.LinAlgError: The coefficients' information is not positive definite.
    """
    moments = filtered.moments
    precision = np.where(sharing, spread**-2.0, own)
    factor = cho_factor(moments[1:, 1:] + np.diag(precision), lower=True)
    change = -cho_solve(factor, moments[1:, 0] + precision * at + pull)
    squares = moments[0, 0] + moments[0, 1:] @ change + (precision * at) @ (at + change)
    determinant = 2.0 * np.log(np.diag(factor[0])).sum() - np.log(precision).sum()
    evidence = -0.5 * (filtered.log_spread + squares + determinant)
    return Regression(change, cho_solve(factor, np.eye(len(at))), precision, spread, float(evidence))


def regress_with_spread(
    filtered: Filtered,
    at: np.ndarray,
    spread: float,
    sharing: np.ndarray,
    pull: np.ndarray | float = 0.0,
    own: np.ndarray | float = 1.0,
) -> Regression:
    """The same with the spread that the observations ask for (MacKay's update)."""
    found = regress(filtered, at, spread, sharing, pull, own)
    for _ in range(SPREAD_ROUNDS if sharing.any() else 0):
        moved = (at + found.change)[sharing]
        before, spread = spread, updated_spread(moved, np.diag(found.covariance)[sharing], spread)
        found = regress(filtered, at, spread, sharing, pull, own)
        if abs(spread / before - 1.0) < SPREAD_TOLERANCE:
            break
    return found
