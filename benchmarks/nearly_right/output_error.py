"""The peer: parameters with which a simulation of the model comes nearest to the sensors, by least squares.

From rest and from the same first guess as the program, told nothing else. A fit of all samples at once from a guess
20 to 40 % off ends in the nearest wrong resonance; so the fit begins with the first periods, and goes on with twice as
many samples each time, as an engineer would.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from scipy.optimize import least_squares

from benchmarks.nearly_right.simulation import Chain

SMALL = 1e-4  # relative step of the differences


class Model(Protocol):
    """What can be fitted: `benchmarks.nearly_right.simulation.Chain` says what its functions do."""

    @property
    def ndof(self) -> int: ...  # noqa: D102

    def states(self, p: np.ndarray, start: np.ndarray, force: np.ndarray, dt: float) -> np.ndarray: ...  # noqa: D102

    def outputs(self, p: np.ndarray, states: np.ndarray, force: np.ndarray) -> np.ndarray: ...  # noqa: D102


def fitted(
    model: Model,
    guess: np.ndarray,
    force: np.ndarray,
    sensors: np.ndarray,
    dt: float,
    first: int,
    noise: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters, (p,), and the covariance of their logarithms, (p, p), as if what is left were white.

    ``force``, as the model takes it (samples first), and ``sensors`` (samples, sensors), SI units, every ``dt``
    seconds; ``first``: samples of the first, shortest fit; ``noise``: of the sensors, by default as their size is.
    """
    rms = np.sqrt(np.mean(sensors**2, axis=0))
    size = rms if noise is None else noise * np.max(rms / noise)
    found, samples = np.log(guess), min(first, len(force))
    while True:
        left = _residual(model, force[:samples], sensors[:samples], size, dt)
        last = samples == len(force)
        accuracy = 1e-10 if last else 1e-4
        solved = least_squares(
            lambda p, left=left: left(p[None])[0],
            found,
            lambda p, left=left: _jacobian(left, p),
            bounds=(np.log(guess) - 5.0, np.log(guess) + 5.0),
            x_scale=0.1,
            ftol=accuracy,
            xtol=accuracy,
            max_nfev=60 if last else 15,
        )
        found = solved.x
        if last:
            freedom = len(solved.fun) - len(found)
            return np.exp(found), np.linalg.pinv(solved.jac.T @ solved.jac) * 2.0 * solved.cost / freedom
        samples = min(2 * samples, len(force))


def _residual(
    model: Model, force: np.ndarray, sensors: np.ndarray, size: np.ndarray, dt: float
) -> Callable[[np.ndarray], np.ndarray]:
    def left(logarithms: np.ndarray) -> np.ndarray:
        p = np.exp(logarithms)
        states = model.states(p, np.zeros((len(p), 2 * model.ndof)), force, dt)
        missed = (model.outputs(p, states, force) - sensors) / size
        return np.clip(np.nan_to_num(missed, nan=1e3), -1e3, 1e3).reshape(len(p), -1)

    return left


def _jacobian(left: Callable[[np.ndarray], np.ndarray], p: np.ndarray) -> np.ndarray:
    steps = SMALL * np.eye(len(p))
    both = left(np.concatenate([p + steps, p - steps]))
    return (both[: len(p)] - both[len(p) :]).T / (2.0 * SMALL)


def missed_percent(model: Chain, p: np.ndarray, force: np.ndarray, sensors: np.ndarray, dt: float) -> float:
    """NMSE, %, mean over the sensors, of a free run of parameters (p,) from the first state that suits it best."""
    n = model.ndof
    rest = model.states(p[None], np.zeros((1, 2 * n)), force, dt)[0]
    unit = np.sqrt(np.mean(rest**2, axis=0))
    size = np.sqrt(np.mean(sensors**2, axis=0))

    def left(starts: np.ndarray) -> np.ndarray:
        every = np.repeat(p[None], len(starts), axis=0)
        shown = model.outputs(every, model.states(every, starts * unit, force, dt), force)
        return np.clip(np.nan_to_num((shown - sensors) / size, nan=1e3), -1e3, 1e3).reshape(len(starts), -1)

    best = least_squares(lambda x: left(x[None])[0], np.zeros(2 * n), lambda x: _jacobian(left, x), max_nfev=20)
    return 100.0 * 2.0 * best.cost / len(force) / sensors.shape[1]
