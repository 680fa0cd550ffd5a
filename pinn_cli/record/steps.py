"""How long the steps of a time integration may be: what is fastest in a structure."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch

if TYPE_CHECKING:
    from pinn_cli.system.structure import Structure

# Runge-Kutta is stable up to 2.8 and accurate to 1e-5 per radian at 0.2 (its phase error is (step * rate)^4 / 120).
STEP_TIMES_RATE = 0.2
# Of a mode that follows what acts on it, steps so much longer do: 1 rad with 0.2.
STABLE_STEP_OVER_STEP = 5.0
# Times the Nyquist frequency beyond which modes get mass, see :func:`with_slow_followers`: 25 steps per sample.
FASTEST_FOLLOWER = 8.0
# Steps of Runge-Kutta per sample from which on implicit steps are taken. Fifty put the highest mode at three times the
# Nyquist frequency of the record.
MOST_SUBSTEPS = 50


class TooStiffError(ValueError):
    """A structure that a record's sampling is much too slow for; the message says by how much."""


def method_needed(structure: Structure, step: float) -> tuple[str, int]:
    """How a structure is followed between samples: ``rk4`` with so many steps, or ``lsoda``."""
    substeps = substeps_needed(structure, step)
    return "lsoda" if substeps > MOST_SUBSTEPS or has_stiff_law(structure) else "rk4", substeps


def has_stiff_law(structure: Structure) -> bool:
    """Whether only implicit steps follow it, see :attr:`Nonlinearity.is_stiff`."""
    return any(group.nonlinearity.is_stiff for group in structure.groups)


def substeps_needed(structure: Structure, step: float, step_times_rate: float = STEP_TIMES_RATE) -> int:
    """Steps of Runge-Kutta per sample that resolve the linear part's highest natural frequency and strongest damping.

    Of modes, those above the Nyquist frequency follow what acts on them at once: they need no more than to stay stable.
    No number of steps is enough where a mass is zero.
    """
    angle = step * _rates(structure).max(axis=0)
    beyond = (angle > math.pi) & structure.is_modal
    steps = angle / np.where(beyond, STABLE_STEP_OVER_STEP * step_times_rate, step_times_rate)
    return max(1, math.ceil(steps.max()))


def follower_masses(structure: Structure, step: float) -> np.ndarray:
    """(n,), factors of at least 1 on the masses, with which no mode is faster than so many times the Nyquist frequency.

    Modes far beyond a record's band follow what acts on them at once, and would make steps short for nothing. With
    mass added they do the same under anything slow: at a frequency f they are off by (f / fastest)^2.
    """
    if not structure.is_modal:
        return np.ones(structure.coordinates)
    fastest = FASTEST_FOLLOWER * math.pi / step
    oscillation, decay = _rates(structure) / fastest
    masses: np.ndarray = np.maximum(1.0, np.maximum(oscillation**2, decay))
    return masses


def with_slow_followers(structure: Structure, step: float) -> Structure:
    """The same structure with these masses; the ground pushes it as before."""
    masses = follower_masses(structure, step)
    if (masses == 1.0).all():
        return structure
    slower = structure.with_parameters(m=structure.parameters["m"] * torch.as_tensor(masses))
    return replace(slower, influence=structure.with_ground / masses)


def fastest_rates(structure: Structure) -> tuple[float, float]:
    """Bounds of the structure's highest natural frequency, rad/s, and strongest damping, 1/s, at rest."""
    oscillation, decay = _rates(structure).max(axis=1)
    return float(oscillation), float(decay)


def _rates(structure: Structure) -> np.ndarray:
    """(2, n), rad/s and 1/s, the same coordinate by coordinate.

    Gershgorin bounds the eigenvalues of M^-1 K (and of M^-1 C alike) by the sums over the connections at a mass, of a
    chain by 2 (|k_i| + |k_i+1|) / |m_i|; an estimated one may have negative ones.
    """
    pull = abs(structure.incidence.matrix)
    # A mode's own spring is stretched by that mode alone, and its rate is no bound.
    weight = np.maximum(0.0 if structure.is_modal else 2.0, np.asarray(pull.sum(axis=1)).reshape(-1))
    mass = np.abs(structure.parameters_like(np.empty(0))["m"])
    stiffness, damping = (pull.T @ (weight * value) / mass for value in at_rest(structure))
    return np.array((np.sqrt(stiffness), damping))


def at_rest(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Size of stiffness (N/m) and of damping (N s/m) of every connection (C,), those of its law at rest included."""
    k, c = (np.abs(parts).sum(axis=0) for parts in structure.at_rest())
    return k, c
