"""Records of structures in SI units, made with scipy alone: no line of the simulator under test."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

from pinn_cli.record.record import Record
from pinn_cli.record.response import QUANTITIES, Response


def chain_matrix(values: np.ndarray) -> np.ndarray:
    """Of springs or dampers between storeys, the first one on the ground."""
    return np.diag(values + np.append(values[1:], 0.0)) - np.diag(values[1:], 1) - np.diag(values[1:], -1)


@dataclass(frozen=True, eq=False)
class Structure:
    """Storeys from the ground up: masses kg, dampers N s/m, springs N/m, N/m^3 and N/m^2."""

    m: np.ndarray
    c: np.ndarray
    k: np.ndarray
    kappa: np.ndarray
    quadratic: float = 0.0

    @property
    def frequencies(self) -> np.ndarray:
        """Natural frequencies of the linear structure, Hz."""
        scaled = chain_matrix(self.k) / np.sqrt(np.outer(self.m, self.m))
        return np.sqrt(np.linalg.eigvalsh(scaled)) / (2.0 * np.pi)

    def moved(self, force, time: np.ndarray) -> Response:
        """Motion from rest under a force on the roof, N, a function of time."""
        n = len(self.m)
        stretch = np.eye(n) - np.eye(n, k=-1)

        def rate(t: float, y: np.ndarray) -> np.ndarray:
            e, de = y.reshape(2, n) @ stretch.T
            carried = self.c * de + e * (self.k + e * (self.quadratic + e * self.kappa))
            pull = -carried @ stretch
            pull[-1] += force(t)
            return np.concatenate((y[n:], pull / self.m))

        shortest = 0.2 / self.frequencies[-1]
        found = solve_ivp(
            rate, (0.0, time[-1]), np.zeros(2 * n), "DOP853", time, rtol=1e-8, atol=1e-14, max_step=shortest
        ).y.T
        acceleration = np.array([rate(t, y)[n:] for t, y in zip(time, found, strict=True)])
        acting = np.zeros_like(acceleration)
        acting[:, -1] = [force(t) for t in time]
        return Response(time, found[:, :n], found[:, n:], acceleration, acting)


def frame(cubic: bool = True) -> Structure:
    """Three storeys, the first one stiffening; 1 to 5 % damping."""
    k = np.array([1.5e6, 1.4e6, 1.2e6])
    kappa = np.array([5e9 if cubic else 0.0, 0.0, 0.0])
    return Structure(np.full(3, 2000.0), 2e-3 * k, k, kappa)


def random_force(low: float, high: float, rms: float, duration: float, seed: int = 0):
    """A function of time: sinusoids of even power between two frequencies, Hz, from rest within half a second."""
    rng = np.random.default_rng(seed)
    frequency = np.linspace(low, high, int(2.0 * duration * (high - low)))
    phase = rng.uniform(0.0, 2.0 * np.pi, len(frequency))
    size = rms * np.sqrt(2.0 / len(frequency))
    return lambda t: min(2.0 * t, 1.0) * size * float(np.sum(np.cos(2.0 * np.pi * frequency * t + phase)))


@dataclass(frozen=True, eq=False)
class IndependentRecord:
    """A record, the truth, and the standard deviation of every sensor's noise by quantity, (n,)."""

    structure: Structure
    record: Record
    truth: Response
    noise: dict[str, np.ndarray]


@cache
def frame_record(
    rate: float = 100.0,
    duration: float = 20.0,
    band: tuple[float, float] = (0.5, 20.0),
    snr_db: float = 30.0,
    cubic: bool = True,
    sensors: tuple[tuple[str, tuple[int, ...]], ...] = (("acceleration", (1, 2, 3)),),
    seed: int = 0,
) -> IndependentRecord:
    """The frame under a force of 2 kN on its roof, with sensors on the given storeys, counted from 1."""
    structure, time = frame(cubic), np.arange(int(duration * rate)) / rate
    truth = structure.moved(random_force(*band, 2000.0, duration, seed), time)
    return measured(structure, truth, dict(sensors), snr_db, seed)


def measured(
    structure: Structure, truth: Response, sensors: dict[str, Sequence[int]], snr_db: float, seed: int = 0
) -> IndependentRecord:
    """The truth with noise, at sensors alone."""
    rng, n = np.random.default_rng([seed, 1]), len(structure.m)
    channels, noise = {}, {}
    for quantity in QUANTITIES:
        exact = getattr(truth, quantity)
        felt = sensors.get(quantity, ()) if quantity != "force" else (n,)
        there = np.isin(np.arange(1, n + 1), felt)
        noise[quantity] = np.where(there, exact.std(axis=0) * 10.0 ** (-snr_db / 20.0), np.nan)
        noisy = exact + np.nan_to_num(noise[quantity]) * rng.standard_normal(exact.shape)
        absent = 0.0 if quantity == "force" else np.nan
        channels[quantity] = np.where(there, noisy, absent)
    record = Record(truth.time, **channels, unforced=np.arange(n) != n - 1)
    return IndependentRecord(structure, record, truth, noise)


def storey_record(
    band: tuple[float, float],
    samples: int,
    rate: float,
    frequency: float,
    snr_db: float,
    seed: int,
    mass: float = 15.0,
    kappa: float = 0.0,
) -> IndependentRecord:
    """One storey with an accelerometer, 1.5 % damping, a natural frequency in Hz, and ``kappa`` of k per m^2."""
    k = mass * (2.0 * np.pi * frequency) ** 2
    c = 0.03 * mass * 2.0 * np.pi * frequency
    structure = Structure(np.array([mass]), np.array([c]), np.array([k]), np.array([kappa * k]))
    time = np.arange(samples) / rate
    truth = structure.moved(random_force(*band, 0.1 * mass, time[-1], seed), time)
    return measured(structure, truth, {"acceleration": (1,)}, snr_db, seed)
