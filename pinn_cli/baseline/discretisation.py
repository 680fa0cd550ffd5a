"""From one sample to the next: the nonlinear motion of every step at once, and its derivative."""

from __future__ import annotations

import math

import numpy as np

from pinn_cli.record.between_samples import between_samples
from pinn_cli.record.record import Record
from pinn_cli.record.runge_kutta_step import Slope, runge_kutta_step

# The exponential's series is summed where step times rate is at most this, and doubled from there.
SERIES_REACH = 0.5


def interpolated_force(record: Record, substeps: int) -> np.ndarray:
    """Measured force at the ends and the middle of every substep, (2 substeps + 1, N - 1, n), N; 0 where unknown."""
    force = between_samples(record.time, np.nan_to_num(record.force), record.intersample)
    return force.within(np.arange(2 * substeps + 1) / (2 * substeps))


def flow(slope: Slope, start: np.ndarray, force: np.ndarray, step: float) -> np.ndarray:
    """Motion one sample later, of many starts at once, by the classical method of Runge and Kutta.

    Args:
        slope: From motion (2, N, n) and force (N, n) to the motion's time derivative.
        start: (2, N, n), displacement and velocity at the beginning of each step.
        force: (2 substeps + 1, N, n), from :func:`interpolated_force`.
        step: From sample to sample, s.
    """
    substeps = len(force) // 2
    state = start
    for i in range(substeps):
        state = runge_kutta_step(slope, state, force[2 * i], force[2 * i + 1], force[2 * i + 2], step / substeps)
    return state


def propagators(rates: np.ndarray, step: float, fastest: float) -> tuple[np.ndarray, np.ndarray]:
    """exp(A h) and its integral from 0 to h, for a stack of matrices A (N, s, s).

    A series for h / 2^j, doubled j times: S(2 t) = S(t) + exp(A t) S(t). For 4096 matrices of size 12 it takes 15 ms,
    where `torch.linalg.matrix_exp` of the augmented matrix that gives both (Van Loan 1978) takes 280 ms.

    Args:
        rates: A, 1/s.
        step: h, s.
        fastest: A bound on the magnitude of the eigenvalues of A, 1/s.
    """
    doublings = max(0, math.ceil(math.log2(max(step * fastest / SERIES_REACH, 1.0))))
    scaled = rates * (step / 2.0**doublings)
    identity = np.eye(rates.shape[1])
    integral = np.broadcast_to(identity, rates.shape)
    for term in range(_series_terms(step * fastest / 2.0**doublings), 1, -1):
        integral = identity + scaled @ integral / term
    through, integral = identity + scaled @ integral, integral * (step / 2.0**doublings)
    for _ in range(doublings):
        integral = integral + through @ integral
        through = through @ through
    return through, integral


def _series_terms(reach: float) -> int:
    """Terms after which reach^terms / terms! is less than the rounding error."""
    terms, size = 1, reach
    while size > np.finfo(float).eps:
        terms += 1
        size *= reach / terms
    return terms
