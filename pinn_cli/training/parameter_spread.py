"""How far believed parameters are off, in common."""

from __future__ import annotations

import numpy as np

# Weight of the user's parameter uncertainty, in parameters, when the common spread is learned from the record. With
# less, a few parameters that a record tells half draw it to zero by chance, and their intervals hold 70 to 80 %.
PRIOR_PARAMETERS = 1.0


def updated_spread(x: np.ndarray, variance: np.ndarray, spread: float) -> float:
    """How far believed parameters are off, in common, as far as the record says.

    MacKay's update of one relative variance, s^2 = (nu + sum x^2) / (nu + gamma), with gamma the number of parameters
    that the record determines and the user's own spread counting as nu parameters. Parameters that are right sharpen
    each other; parameters that are wrong free each other.

    Args:
        x: (p,), distances from the prescribed values, in the user's standard deviations.
        variance: (p,), posterior variances, in their squares.
        spread: Under which both were found.
    """
    determined = float((1.0 - variance / spread**2).clip(min=0.0).sum())
    return float(np.sqrt((PRIOR_PARAMETERS + float(x @ x)) / (PRIOR_PARAMETERS + determined)))
