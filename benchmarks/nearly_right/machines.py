"""Twelve machines, each with an error that its model lacks: the truth, by scipy's LSODA.

All errors act at the first connection, between the fixed end and DOF 1, or at a sensor. Their sizes are relative to the
motion there: the rms elongation A and its rate V of the linear chain at the machine's level. A record has an
excitation, a level, noise and first guesses of its own; the machine stays the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from benchmarks.nearly_right.simulation import Chain

FINE = 8  # times a sensor's rate: the truth's force
COULOMB = 0.12  # friction over k A
Slope = tuple[float, Sequence[float]]
# Elongation e, m; its rate v, m/s; hidden states; time, s -> force of the error, N, and rates of the hidden states.
Error = Callable[[float, float, Sequence[float], float], Slope]


@dataclass(frozen=True)
class Machine:
    """A linear chain, kg, N s/m, N/m; how it is driven and measured: rms elongation at DOF 1, m, rate, Hz, and s."""

    m: np.ndarray
    c: np.ndarray
    k: np.ndarray
    sensors: tuple[tuple[str, int], ...]
    motion: float
    rate: float
    duration: float

    @property
    def model(self) -> Chain:
        """The linear chain; its last mass is driven."""
        return Chain(len(self.m), len(self.m), self.sensors)

    @property
    def linear(self) -> np.ndarray:
        """Parameters of the linear chain, in the order of its names."""
        return np.concatenate([self.m, self.c, self.k])

    @property
    def frequencies(self) -> np.ndarray:
        """Natural frequencies, Hz."""
        k = self.k
        stiffness = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
        return np.sqrt(np.linalg.eigvalsh(stiffness / np.sqrt(np.outer(self.m, self.m)))) / (2.0 * np.pi)


# n, mass of each, kg, first frequency, Hz, damping ratio, rms motion, m, sensors, duration, s.
SCALES = (
    (1, 0.5, 40.0, 0.015, 2e-4, (("acceleration", 1),), 20.0),
    (1, 12.0, 3.0, 0.06, 1e-2, (("displacement", 1),), 40.0),
    (3, 5.0, 6.0, 0.012, 1e-3, (("acceleration", 1), ("acceleration", 3)), 24.0),
    (1, 2500.0, 8.0, 0.03, 5e-4, (("displacement", 1), ("acceleration", 1)), 30.0),
    (2, 300.0, 2.5, 0.02, 4e-3, (("acceleration", 1), ("acceleration", 2)), 40.0),
    (3, 1e5, 0.6, 0.02, 5e-3, (("acceleration", 1), ("acceleration", 2), ("acceleration", 3)), 60.0),
)


def machine(number: int) -> Machine:
    """A machine of one of the six scales, from 0.5 kg at 40 Hz to storeys of 100 t."""
    n, mass, frequency, ratio, motion, sensors, duration = SCALES[number % len(SCALES)]
    random = np.random.default_rng(number)
    m = mass * random.uniform(0.85, 1.15, n)
    raw = Machine(m, np.zeros(n), mass * random.uniform(0.85, 1.15, n), sensors, motion, 1.0, duration)
    k = raw.k * (frequency / raw.frequencies[0]) ** 2
    c = 2.0 * ratio / (2.0 * np.pi * frequency) * k * random.uniform(0.8, 1.2, n)
    if n > 1:
        c = c * 0.7  # the upper modes have more
    there = replace(raw, k=k, c=c)
    rate = 10.0 * 1.4 * there.frequencies[-1]
    step = 10.0 ** math.floor(math.log10(rate)) / 2.0
    return replace(there, rate=math.ceil(rate / step) * step)


def random_signal(low: float, high: float, rate: float, duration: float, random: np.random.Generator) -> np.ndarray:
    """Gaussian noise of even power between two frequencies, Hz, rms one, from zero within two periods of the lower."""
    samples = round(1.25 * duration * rate)
    frequency = np.fft.rfftfreq(samples, 1.0 / rate)
    inside = (frequency >= low) & (frequency <= high)
    lines = np.where(inside, random.standard_normal((2, len(frequency))).T @ [1.0, 1.0j], 0.0)
    values = np.fft.irfft(lines, samples)[: round(duration * rate) + 1]
    return values / values.std() * np.minimum(np.arange(len(values)) / rate * low / 2.0, 1.0)


class Setting(NamedTuple):
    """What sizes of errors refer to: k, c, m at DOF 1, rms elongation A and rate V, omega = V / A, and the duration."""

    k: float
    c: float
    m: float
    A: float
    V: float
    duration: float

    @property
    def omega(self) -> float:
        """Typical angular frequency of the elongation, rad/s."""
        return self.V / self.A


def stick_slip(s: Setting) -> Error:
    """Friction that sticks on bristles of 1 % of the motion and is 1.4 times larger at rest than in motion."""
    coulomb, bristle = COULOMB * s.k * s.A, 0.01 * s.A

    def force(e: float, v: float, z: Sequence[float], t: float) -> Slope:
        limit = 1.0 + 0.4 * math.exp(-((v / (0.15 * s.V)) ** 2))
        dz = v - abs(v) * z[0] / (bristle * limit)
        return coulomb * z[0] / bristle, (dz,)

    return force


def quadratic_damping(s: Setting) -> Error:
    """A drag with the square of the velocity."""
    drag = 0.8 * s.c / s.V
    return lambda e, v, z, t: (drag * abs(v) * v, ())


def backlash(s: Setting) -> Error:
    """A play in the spring of 1 % of the motion, which goes from -3 A to 3 A."""
    half = 0.5 * 0.01 * 6.0 * s.A
    return lambda e, v, z, t: (-s.k * min(max(e, -half), half), ())


def second_mode(s: Setting) -> Error:
    """A part of 1.5 % of the mass on a spring of its own, 1.3 times the frequency."""
    m, omega = 0.015 * s.m, 1.3 * s.omega

    def force(e: float, v: float, z: Sequence[float], t: float) -> Slope:
        pull = m * omega**2 * (e - z[0]) + 0.02 * m * omega * (v - z[1])
        return pull, (z[1], pull / m)

    return force


def stiffer_one_way(s: Setting) -> Error:
    """A spring 3 % stiffer one way: the least of the twelve, a free run of the linear chain misses 0.04 %."""
    return lambda e, v, z, t: (0.03 * s.k * max(e, 0.0), ())


def cable(s: Setting) -> Error:
    """A cable that is slack up to the rms motion, and then pulls with 20 % of the stiffness."""
    return lambda e, v, z, t: (0.2 * s.k * max(e - s.A, 0.0), ())


def bouc_wen(s: Setting) -> Error:
    """A tenth of the stiffness yields at about three times the rms motion, and loses a third over the record."""
    stiffness, beta = 0.1 * s.k, 0.5 / (3.0 * s.A)

    def force(e: float, v: float, z: Sequence[float], t: float) -> Slope:
        lost = 1.0 + 0.5 * z[1]
        dz = (v - beta * (abs(v) * z[0] + v * abs(z[0])) * (1.0 + z[1])) / lost
        return stiffness * z[0], (dz, abs(z[0] * v) / (s.A * s.V * s.duration))

    return force


def sliding_mass(s: Setting) -> Error:
    """A mass of 6 % lies on DOF 1 and slides beyond 1.2 times the rms acceleration."""
    m, holds, smooth = 0.06 * s.m, 0.06 * s.m * 1.2 * s.omega * s.V, 0.01 * s.V

    def force(e: float, v: float, z: Sequence[float], t: float) -> Slope:
        pull = holds * math.tanh((v - z[0]) / smooth)
        return pull, (pull / m,)

    return force


def temperature(s: Setting) -> Error:
    """The spring loses 2 % of its stiffness over the record, fastest at its middle."""
    return lambda e, v, z, t: (-0.02 * s.k * e * 0.5 * (1.0 - math.cos(math.pi * t / s.duration)), ())


def right(s: Setting) -> Error:
    """No error."""
    return lambda e, v, z, t: (0.0, ())


@dataclass(frozen=True)
class Kind:
    """An error: its law and hidden states, or what it does to a sensor; on which machine; words that name it.

    ``lag``: of the load cell, times 1/omega. ``tilt``: of the accelerometers, times omega_1^2. ``floor``: rms
    acceleration of the floor over that of DOF 1. ``friction``: the model has smooth friction. ``holds``: what the error
    adds to a parameter where the motion is small, as a share of it.
    """

    machine: int
    names: str
    law: Callable[[Setting], Error] = right
    hidden: int = 0
    lag: float = 0.0
    tilt: float = 0.0
    floor: float = 0.0
    friction: bool = False
    holds: dict[str, float] = field(default_factory=dict)


KINDS = {
    "stick_slip": Kind(1, "stick|stribeck|hyster", stick_slip, 1, friction=True),
    "quadratic_damping": Kind(3, "quadratic damp|velocity.squared|square of (?:the )?velocity", quadratic_damping),
    "backlash": Kind(0, "backlash|play of|dead zone", backlash),
    "second_mode": Kind(3, "a mode at|mode more|another mode|not in the model", second_mode, 2, holds={"m_1": 0.015}),
    "stiffer_one_way": Kind(4, "quadratic|one way|one side", stiffer_one_way),
    "cable": Kind(1, "quadratic|cubic|one way|one side|slack", cable),
    "floor": Kind(5, r"ground moves|floor|support|\bbase\b", floor=0.1),
    "lagging_load_cell": Kind(2, r"\blag|delay|\blate\b", lag=0.06),
    "tilt": Kind(5, "tilt|gravity", tilt=0.25),
    "bouc_wen": Kind(4, "hyster|bouc", bouc_wen, 2, holds={"k_1": 0.1}),
    "sliding_mass": Kind(0, "slid|friction|missing mass", sliding_mass, 1, holds={"m_1": 0.06}),
    "temperature": Kind(2, "temperature|over time|with time|drifts", temperature),
    "none": Kind(0, "^$"),
}


@dataclass(frozen=True)
class Measured:
    """A record: the machine, the model that is fitted, time, force and sensors as measured; first guesses; truth.

    The first guesses are 20 to 40 % off; ``true`` is what m, c and k are where the motion is small.
    """

    machine: Machine
    model: Chain
    time: np.ndarray
    force: np.ndarray
    sensors: np.ndarray
    guess: np.ndarray
    true: np.ndarray

    @property
    def half(self) -> int:
        """Samples of the half that is fitted."""
        return len(self.time) // 2


def measured(kind: str, record: int, number: int | None = None) -> Measured:
    """Record ``record`` of the kind's machine, or of another one by its ``number``."""
    what = KINDS[kind]
    number = what.machine if number is None else number
    there = machine(number)
    random = np.random.default_rng([list(KINDS).index(kind), number, record])
    n, fine, dt = len(there.m), there.rate * FINE, 1.0 / there.rate
    low, high = 0.3 * there.frequencies[0], 1.4 * there.frequencies[-1]
    shape = random_signal(low, high, fine, there.duration, random)
    # The size that all records of the machine have in common: the stationary response to this spectrum.
    common = random_signal(low, high, there.rate, 40.0 * there.duration, np.random.default_rng(number))
    still = np.zeros((1, 2 * n))
    states = there.model.states(there.linear[None], still, common, dt)[0]
    per_force = there.motion / states[:, 0].std()
    level = math.exp(random.uniform(-0.35, 0.35))
    force = level * per_force * shape
    rate = per_force * states[:, n].std()
    s = Setting(there.k[0], there.c[0], there.m[0], there.motion, rate, there.duration)
    rough = there.model.outputs(there.linear[None], states[None], common)[0].std(axis=0) * per_force
    floor = what.floor * s.omega * s.V * random_signal(0.3 * low, 0.9 * low / 0.3, fine, there.duration, random)
    time, motion = moved(there, what.law(s), what.hidden, force, floor)
    clean = []
    for quantity, dof in there.sensors:
        x, v, a = (motion[quantity][:, dof - 1] for quantity in ("displacement", "velocity", "acceleration"))
        if quantity == "acceleration":
            a = a + floor[::FINE] + what.tilt * (2.0 * np.pi * there.frequencies[0]) ** 2 * x
        clean.append({"displacement": x, "velocity": v, "acceleration": a}[quantity])
    lag = what.lag / s.omega * fine  # samples
    cell = lfilter([1.0 / (1.0 + lag)], [1.0, -lag / (1.0 + lag)], force)[::FINE]
    signals = np.stack([cell, *clean], axis=1)
    nominal = np.append(per_force, rough)
    noise = nominal * 10.0 ** (-random.uniform(40.0, 60.0, len(nominal)) / 20.0)
    signals = signals + noise * random.standard_normal(signals.shape)
    model, true = there.model, there.linear
    if what.friction:
        model, true = replace(model, speed=0.3 * s.V), np.append(true, np.full(n, COULOMB * s.k * s.A))
    off = random.uniform(0.2, 0.4, len(true)) * random.choice([-1.0, 1.0], len(true))
    small = np.array([1.0 + what.holds.get(name, 0.0) for name in model.names])
    return Measured(there, model, time, signals[:, 0], signals[:, 1:], true * (1.0 + off), true * small)


def moved(
    there: Machine, error: Error, hidden: int, force: np.ndarray, floor: np.ndarray
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times and motion relative to the floor, (samples, n), from rest, under a force at the last DOF and a floor."""
    n, fine = len(there.m), there.rate * FINE
    m, c, k = there.m.tolist(), there.c.tolist(), there.k.tolist()
    knots = np.arange(len(force)) / fine
    pieces = [CubicSpline(knots, values).c.T.tolist() for values in (force, floor)]
    last = len(knots) - 2

    def rates(t: float, state: np.ndarray) -> list[float]:
        y = state.tolist()
        i = min(max(int(t * fine), 0), last)
        h = t - i / fine
        f, g = (((p[i][0] * h + p[i][1]) * h + p[i][2]) * h + p[i][3] for p in pieces)
        added, more = error(y[0], y[n], y[2 * n :], t)
        pull = [-mass * g for mass in m]
        pull[-1] += f
        below_x = below_v = 0.0
        for j in range(n):
            carried = k[j] * (y[j] - below_x) + c[j] * (y[n + j] - below_v) + (added if j == 0 else 0.0)
            below_x, below_v = y[j], y[n + j]
            pull[j] -= carried
            if j:
                pull[j - 1] += carried
        return [*y[n : 2 * n], *(p / mass for p, mass in zip(pull, m, strict=True)), *more]

    time = np.arange(round(there.duration * there.rate) + 1) / there.rate
    tiny = 1e-8 * there.motion
    found = solve_ivp(
        rates, (0.0, time[-1]), np.zeros(2 * n + hidden), "LSODA", time, rtol=1e-7, atol=tiny, max_step=1.0 / there.rate
    ).y.T
    acceleration = np.array([rates(t, y)[n : 2 * n] for t, y in zip(time.tolist(), found, strict=True)])
    return time, {"displacement": found[:, :n], "velocity": found[:, n : 2 * n], "acceleration": acceleration}
