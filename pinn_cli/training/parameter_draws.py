"""Structures whose parameters are drawn from what is known of them after the training."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pinn_cli.system.parameters import MASS
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import ParameterEstimate

# A mass is not drawn below this part of its estimate.
LEAST_MASS = 0.01


def parameter_draws(
    parameters: Sequence[ParameterEstimate], correlation: np.ndarray | None, count: int, seed: int
) -> np.ndarray | None:
    """(count, p) draws of a Gaussian with the estimates' deviations and correlation; None where these are unknown.

    What falls below a bound is put onto it.
    """
    estimate, std = (np.array([getattr(found, name) for found in parameters]) for name in ("estimate", "std"))
    if not len(parameters):
        return np.zeros((count, 0))
    if correlation is None and len(parameters) == 1:
        correlation = np.eye(1)
    if correlation is None or not (np.isfinite(std).all() and np.isfinite(correlation).all()):
        return None
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(values.clip(min=0.0))
    draws = estimate + std * (np.random.default_rng([seed, 2]).standard_normal((count, len(std))) @ root.T)
    lower = np.array([found.parameter.prescribed + found.parameter.lower for found in parameters])
    return np.maximum(draws, np.where(np.isnan(lower), -np.inf, lower))


def drawn_structures(
    structure: Structure, parameters: Sequence[ParameterEstimate], draws: np.ndarray
) -> dict[str, np.ndarray]:
    """Kind to (count, members of the kind): the parameters of a structure, those that were drawn in their places.

    Args:
        structure: With the others.
        parameters: p of them; those of sensors have no part in it.
        draws: (count, p).
    """
    own = structure.parameters_like(np.empty(0))
    every = {kind: np.tile(values, (len(draws), 1)) for kind, values in own.items()}
    for column, found in enumerate(parameters):
        if found.kind not in CALIBRATION_UNITS:
            every[found.kind][:, found.parameter.index] = draws[:, column]
    every[MASS] = np.maximum(every[MASS], LEAST_MASS * own[MASS])
    return every
