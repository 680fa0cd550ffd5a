"""What the parameters' uncertainty does to something that follows from them, to first order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pinn_cli.training.estimate import ParameterEstimate


def half_widths_90(
    slopes: np.ndarray, parameters: Sequence[ParameterEstimate], correlation: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """How far the central 90 % intervals of quantities reach below and above their estimates.

    Of Gaussian parameters with covariance S the half width is 1.645 sqrt(g' S g), g the slope. A parameter's interval
    may be lopsided, as beside a bound. What counts is then its half on the side to which the quantity moves.

    Args:
        slopes: (..., p), derivatives of the quantities by the parameters, in their own units.
        parameters: p of them.
        correlation: (p, p), their posterior correlation; None where it is unknown.

    Returns:
        (...) each; NaN where nothing is uncertain, and where an interval or the correlation is unknown.
    """
    shape = slopes.shape[:-1]
    if not parameters or (correlation is None and len(parameters) > 1):
        return np.full(shape, np.nan), np.full(shape, np.nan)
    together = np.eye(1) if correlation is None else correlation
    lower, upper = (np.array([getattr(p, name) for p in parameters]) for name in ("lower_90", "upper_90"))
    estimate = np.array([p.estimate for p in parameters])
    reach = np.stack((estimate - lower, upper - estimate)).clip(min=0.0)
    widths = []
    for rising, falling in ((0, 1), (1, 0)):
        moved = slopes * np.where(slopes > 0, reach[rising], reach[falling])
        width = np.sqrt(np.einsum("...i,ij,...j->...", moved, together, moved).clip(min=0.0))
        widths.append(np.where(width > 0.0, width, np.nan))
    return widths[0], widths[1]
