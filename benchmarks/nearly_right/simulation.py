"""Simulation of the models that are fitted: chains of masses, springs and dampers, with smooth friction or without.

By numpy and scipy alone, no line of the program: linear chains by their poles and straight lines through a force that
is made eight times denser, chains with friction by Runge-Kutta steps, all parameter sets of a batch at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import lfilter

DENSER = 8  # intervals of a linear simulation between two samples
STEPS = 4  # Runge-Kutta steps between two samples


@dataclass(frozen=True)
class Chain:
    """A model: masses in a row, DOF 1 nearest the fixed end, a measured force on one of them, sensors on some.

    ``speed``, m/s, is that over which friction changes its sign, F_c tanh(de / speed); None: there is no friction.
    ``sensors``: quantity (displacement, velocity, acceleration) and DOF, from 1. Parameters come in the order of
    `names`, those of the program.
    """

    ndof: int
    driven: int
    sensors: tuple[tuple[str, int], ...]
    speed: float | None = None

    @property
    def names(self) -> list[str]:
        """m_1, ..., c_1, ..., k_1, ..., and F_c_1, ... where there is friction."""
        kinds = ("m", "c", "k") if self.speed is None else ("m", "c", "k", "F_c")
        return [f"{kind}_{dof}" for kind in kinds for dof in range(1, self.ndof + 1)]

    def states(self, p: np.ndarray, start: np.ndarray, force: np.ndarray, dt: float) -> np.ndarray:
        """Displacements and velocities, (batch, samples, 2 n), of parameters (batch, p) and first states (batch, 2 n).

        The force, N, is measured at every sample, (samples,).
        """
        if self.speed is not None:
            return self._stepped(p, start, force, dt)
        return np.stack([self._by_poles(*each, force, dt) for each in zip(p, start, strict=True)])

    def outputs(self, p: np.ndarray, states: np.ndarray, force: np.ndarray) -> np.ndarray:
        """What the sensors show, (batch, samples, sensors)."""
        n = self.ndof
        motion = {"displacement": states[..., :n], "velocity": states[..., n:]}
        motion["acceleration"] = self._acceleration(p[:, None], states, force[:, None])
        return np.stack([motion[quantity][..., dof - 1] for quantity, dof in self.sensors], axis=-1)

    def _acceleration(self, p: np.ndarray, states: np.ndarray, force: np.ndarray) -> np.ndarray:
        n = self.ndof
        e, de = (np.diff(half, prepend=0.0) for half in (states[..., :n], states[..., n:]))
        carried = p[..., n : 2 * n] * de + p[..., 2 * n : 3 * n] * e
        if self.speed is not None:
            carried = carried + p[..., 3 * n :] * np.tanh(de / self.speed)
        pull = -carried
        pull[..., :-1] += carried[..., 1:]
        pull[..., self.driven - 1] += force[..., 0]
        return pull / p[..., :n]

    def _by_poles(self, p: np.ndarray, start: np.ndarray, force: np.ndarray, dt: float) -> np.ndarray:
        n = self.ndof
        at_rest, free = np.zeros((2 * n, 1)), p[None]
        moved = self._acceleration(free, np.eye(2 * n), at_rest)
        matrix = np.vstack([np.eye(2 * n)[n:], moved.T])
        push = np.append(np.zeros(n), self._acceleration(free, np.zeros((1, 2 * n)), np.ones((1, 1))))
        return by_poles(matrix, push[:, None], start, force[:, None], dt)

    def _stepped(self, p: np.ndarray, start: np.ndarray, force: np.ndarray, dt: float) -> np.ndarray:
        n, h, samples = self.ndof, dt / STEPS, len(force)
        times = np.arange((samples - 1) * 2 * STEPS + 1) / (2 * STEPS)
        dense = make_interp_spline(np.arange(samples), force, k=5)(times)[:, None]

        def slope(y: np.ndarray, f: np.ndarray) -> np.ndarray:
            return np.concatenate([y[:, n:], self._acceleration(p, y, f)], axis=1)

        y, states = start, np.empty((samples, *start.shape))
        states[0] = start
        for step in range((samples - 1) * STEPS):
            early, middle, late = dense[2 * step : 2 * step + 3]
            a = slope(y, early)
            b = slope(y + 0.5 * h * a, middle)
            c = slope(y + 0.5 * h * b, middle)
            y = y + h / 6.0 * (a + 2.0 * (b + c) + slope(y + h * c, late))
            if (step + 1) % STEPS == 0:
                states[(step + 1) // STEPS] = y
        return states.transpose(1, 0, 2)


def by_poles(matrix: np.ndarray, push: np.ndarray, start: np.ndarray, force: np.ndarray, dt: float) -> np.ndarray:
    """States (samples, s) of x' = matrix x + push f(t) from the first one, (s,).

    The forces, (samples, forces), are known at every sample; `push` is (s, forces).
    """
    h, samples = dt / DENSER, len(force)
    poles, shapes = np.linalg.eig(matrix)
    inwards = np.linalg.solve(shapes, np.column_stack([push, start]).astype(complex))
    dense = make_interp_spline(np.arange(samples), force, k=5)(np.arange((samples - 1) * DENSER + 1) / DENSER)
    decay = np.exp(poles * h)
    even = (decay - 1.0) / poles
    rising = (even / h - 1.0) / poles
    states = np.empty((len(poles), samples), dtype=complex)
    for i in range(len(poles)):
        acting = dense @ inwards[i, :-1]
        step = (even[i] - rising[i]) * acting[:-1] + rising[i] * acting[1:]
        states[i] = lfilter([1.0], [1.0, -decay[i]], np.append(inwards[i, -1], step))[::DENSER]
    return (shapes @ states).real.T
