"""From a posterior that bounds may cut off to estimates that lie inside their intervals.

The central 90 % interval, which every table of parameters gives.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pinn_cli.model.truncated_gaussian import TruncatedGaussian
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.estimate import ParameterEstimate

# Its ends as probabilities.
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
        ParameterEstimate(
            p, p.value(distance[i]), float(std[i]), p.value(lower[i]), p.value(upper[i]), bool(held[i])
        )
        for i, p in enumerate(uncertain)
    ]  # fmt: skip
