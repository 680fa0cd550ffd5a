"""Random forces as sums of sinusoids, and the motion of a linear structure under them in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from benchmarks.trust.structures import Motion

AT_ONCE = 500  # times of one product of matrices, for memory


@dataclass(frozen=True)
class Waves:
    """Forces Re sum_l amplitude_l exp(2 pi i f_l (t - begin)), which grow from zero over the first `ramp` seconds.

    Attributes:
        frequency: Hz, (lines,).
        amplitude: Complex, N, (lines, forces).
        ramp: s.
        begin: s; before the record where the structure is to move at its first sample.
    """

    frequency: np.ndarray
    amplitude: np.ndarray
    ramp: float
    begin: float = 0.0

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Forces at the times, (time, forces)."""
        since = np.asarray(times) - self.begin
        return np.clip(since / self.ramp, 0.0, 1.0)[:, None] * self._at(since, self.amplitude).real

    def _at(self, since: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        parts = np.array_split(since, max(1, len(since) // AT_ONCE))
        return np.vstack([np.exp(2j * np.pi * np.outer(part, self.frequency)) @ coefficients for part in parts])

    def moves(self, M: np.ndarray, C: np.ndarray, K: np.ndarray, where: np.ndarray, times: np.ndarray) -> Motion:
        """Motion at the times of a structure that is at rest when the forces begin; where: (n, forces).

        In each complex mode, z' = lambda z + g(t), a line of the grown force makes a wave and free decay, and a line of
        a force that grows a wave that grows.
        """
        n, since, s = len(M), np.asarray(times) - self.begin, 2j * np.pi * self.frequency[:, None]
        A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
        poles, shapes = np.linalg.eig(A)
        input_shape = np.vstack([np.zeros_like(where), np.linalg.solve(M, where)])
        wave = (self.amplitude @ np.linalg.solve(shapes, input_shape.astype(complex)).T) / (s - poles)
        grows, lags = wave / self.ramp, -wave / self.ramp / (s - poles)
        full = self.ramp
        left = np.exp(s * full)
        at_full = ((grows * full + lags) * left).sum(0) - lags.sum(0) * np.exp(poles * full)
        decay = np.exp(np.maximum(since - full, 0.0)[:, None] * poles) * (at_full - (wave * left).sum(0))
        z = self._at(since, wave) + decay
        early = since < full
        if early.any():
            t = since[early]
            z[early] = t[:, None] * self._at(t, grows) + self._at(t, lags) - lags.sum(0) * np.exp(np.outer(t, poles))
        u, v = np.hsplit((z @ shapes.T).real, 2)
        a = np.linalg.solve(M, where @ self(times).T - C @ v.T - K @ u.T).T
        return Motion(u, v, a, np.zeros((len(since), 0)))


def random_waves(
    rng: Generator, band: tuple[float, float], rms: np.ndarray, lines: int, falls: Callable[[np.ndarray], np.ndarray]
) -> Waves:
    """Independent Gaussian forces of a band, Hz; they are at their full size after one period of its lower end.

    There is a line in each of as many parts of the band: drawn all over it they leave gaps, and a resonance is driven
    by far more, or less, than Gaussian forces of that spectrum would.

    Args:
        rng: Draws frequencies, sizes and phases.
        band: Lower and upper end, Hz.
        rms: N, (forces,).
        lines: How many sinusoids.
        falls: Their rms at a frequency over that at another one; `np.ones_like` for a flat spectrum.
    """
    frequency = np.interp(np.arange(lines) + rng.uniform(size=lines), (0.0, lines), band)
    drawn = rng.normal(size=(lines, len(rms), 2)) @ np.array([1.0, 1j])
    size = drawn * falls(frequency)[:, None]
    return Waves(frequency, size * rms / np.sqrt(0.5 * (np.abs(size) ** 2).sum(0)), 1.0 / band[0])
