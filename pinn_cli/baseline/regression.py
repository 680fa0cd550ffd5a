"""The coefficients of a filtered time series: parameters and initial state, and how probable all of it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from pinn_cli.baseline.linear_gaussian import Filtered


@dataclass(frozen=True, eq=False)
class Regression:
    """Gaussian posterior of the coefficients of a filtered series.

    Attributes:
        change: (p,), posterior mean, from the point of linearisation.
        covariance: (p, p).
        precision: (p,), of their prior.
        log_evidence: Logarithm of the probability density of the observations, up to a constant.
    """

    change: np.ndarray
    covariance: np.ndarray
    precision: np.ndarray
    log_evidence: float


def regress(filtered: Filtered, at: np.ndarray, precision: np.ndarray, pull: np.ndarray | float = 0.0) -> Regression:
    """Generalised least squares of the innovations on the coefficients.

    Args:
        filtered: Deviations from a trajectory.
        at: (p,), distance of the trajectory's coefficients from their prior mean, in prior standard deviations.
        precision: (p,), of their prior, in these.
        pull: (p,), derivative of what the misfit lacks, see
            :meth:`pinn_cli.baseline.iterated_smoother.IteratedSmoother.pull_of_gains`.

    Raises:
        numpy.linalg.LinAlgError: The coefficients' information is not positive definite.
    """
    moments = filtered.moments
    factor = cho_factor(moments[1:, 1:] + np.diag(precision), lower=True)
    change = -cho_solve(factor, moments[1:, 0] + precision * at + pull)
    squares = moments[0, 0] + moments[0, 1:] @ change + (precision * at) @ (at + change)
    determinant = 2.0 * np.log(np.diag(factor[0])).sum() - np.log(precision).sum()
    evidence = -0.5 * (filtered.log_spread + squares + determinant)
    return Regression(change, cho_solve(factor, np.eye(len(at))), precision, float(evidence))
