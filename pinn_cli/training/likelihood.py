"""What a sampler needs to know of a record: the log-likelihood of the parameters, from precomputed matrices."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np


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
