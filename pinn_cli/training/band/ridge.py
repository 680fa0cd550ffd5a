"""A weak prior on the readout weights."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pinn_cli.system.dynamics import Dynamics
from pinn_cli.training.band.layout import BandLayout

# Relative to the largest diagonal of the first normal matrix: keeps directions that nothing measures from running away.
# Fourier features on a period longer than the record have such directions: below 1e-15 their Gauss-Newton steps never
# settle; splines do not notice it.
RELATIVE_RIDGE = 1e-15


def ridge_of(diagonal: np.ndarray, dynamics: Dynamics, layout: BandLayout) -> float | np.ndarray:
    """Of every unknown: DOFs share one; modes, forces and the ground's acceleration have their own.

    Modes may be a million times as stiff as the lowest one is, whose ridge would then be no weak prior.

    Args:
        diagonal: (size,), of the first normal matrix.
        dynamics: For its functions.
        layout: Of the readout weights.
    """
    if dynamics.is_plain:
        return RELATIVE_RIDGE * float(diagonal.max())
    by_function = layout.weights(torch.from_numpy(diagonal))  # (count, functions)
    largest = by_function.amax(0)
    if dynamics.structure.shapes is None:
        largest[: dynamics.ndof] = largest[: dynamics.ndof].max()
    return RELATIVE_RIDGE * layout.unknowns(largest.expand_as(by_function)).numpy()


def carried_ridge(ridge: float | np.ndarray | None, part: BandLayout, whole: BandLayout) -> float | np.ndarray | None:
    """The ridge of a part of a record on all of it: it hangs on the first weights, and should not on the way taken."""
    if not isinstance(ridge, np.ndarray):
        return ridge
    by_function = part.weights(torch.from_numpy(ridge))[0]
    return whole.unknowns(by_function.expand(whole.count, whole.ndof)).numpy()


def ridge_loss(ridge: float | np.ndarray | None, unknowns: Tensor) -> float:
    """Weighted sum of squares of the unknowns (size,)."""
    if isinstance(ridge, np.ndarray):
        return float((torch.as_tensor(ridge).to(unknowns) * unknowns.square()).sum())
    return (ridge or 0.0) * float(unknowns.square().sum())
