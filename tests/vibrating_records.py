"""Records of structures whose modes are known, by scipy alone: every mode is a filter of second order."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import cont2discrete, lfilter

FINER = 4  # steps of the simulation in one of the record


@dataclass(frozen=True, eq=False)
class Vibrating:
    """M'' + ... in modes.

    Attributes:
        frequency: (modes,), Hz.
        damping: (modes,), ratios.
        shapes: (dofs, modes), modal masses one.
    """

    frequency: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray

    @classmethod
    def chain(cls, first: float, stiffness: list[float], damping: list[float]) -> "Vibrating":
        """Masses of one, springs in these proportions from the support on."""
        drift = np.eye(len(stiffness)) - np.eye(len(stiffness), k=-1)
        squares, shapes = np.linalg.eigh(drift.T @ np.diag(stiffness) @ drift)
        f = np.sqrt(squares)
        return cls(first * f / f[0], np.array(damping), shapes)

    def accelerations(self, pushed: np.ndarray, rate: float) -> np.ndarray:
        """(N, dofs), under modal forces (N, modes) with straight lines between samples."""
        found = np.zeros((len(pushed), len(self.shapes)))
        for f, zeta, shape, force in zip(self.frequency, self.damping, self.shapes.T, pushed.T, strict=True):
            w = 2.0 * np.pi * f
            b, a, _ = cont2discrete(([1.0, 0.0, 0.0], [1.0, 2.0 * zeta * w, w**2]), 1.0 / rate, method="foh")
            found += np.outer(lfilter(np.ravel(b), a, force), shape)
        return found


def coloured(random: np.random.Generator, samples: int, rate: float, low: float, high: float) -> np.ndarray:
    """(samples,), Gaussian, of even power between two frequencies and soft edges; rms one."""
    f = np.fft.rfftfreq(samples, 1.0 / rate)
    gain = 1.0 / (1.0 + (f / high) ** 16) * (f > low)
    x = np.fft.irfft(np.fft.rfft(random.normal(size=samples)) * gain, samples)
    return x / x.std()


def low_passed(seed: int, count: int, cutoff: float = 0.5) -> np.ndarray:
    """Band-limited, with content up to a frequency per sample."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(count))
    return np.fft.irfft(np.where(np.fft.rfftfreq(count) <= cutoff, spectrum, 0.0), count)


def noisy(random: np.random.Generator, values: np.ndarray, part: float) -> np.ndarray:
    """With white noise of this part of every channel's rms."""
    return values + part * values.std(axis=0) * random.normal(size=values.shape)


def ambient(structure: Vibrating, seconds: float, rate: float, seed: int, noise: float = 0.1) -> np.ndarray:
    """(N, dofs), accelerations under forces that are independent at every DOF."""
    random, fine = np.random.default_rng(seed), FINER * rate
    n, before = int(seconds * fine), int(20 * fine / structure.frequency[0])
    force = np.stack([coloured(random, n + before, fine, 0.0, 0.42 * rate) for _ in structure.shapes], axis=1)
    a = structure.accelerations(force @ structure.shapes, fine)[before::FINER]
    return noisy(random, a, noise)


def forced(
    structure: Vibrating, force: np.ndarray, dof: int, rate: float, seed: int, noise: float = 0.03
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) force and (N, dofs) accelerations, of a force (FINER N,) at a DOF from rest."""
    random = np.random.default_rng(10_000 + seed)
    a = structure.accelerations(force[:, None] * structure.shapes[dof], FINER * rate)[::FINER]
    return noisy(random, force[::FINER], 0.3 * noise), noisy(random, a, noise)


def shaker(samples: int, rate: float, seed: int, low: float, high: float) -> np.ndarray:
    return coloured(np.random.default_rng(seed), FINER * samples, FINER * rate, low, high)


def hammer(samples: int, rate: float, seed: int, blows: int, width: float) -> np.ndarray:
    """Half sines of about `width` seconds, a blow in each part of the record; zero otherwise."""
    random, n = np.random.default_rng(seed), FINER * samples
    force, time = np.zeros(n), np.arange(n) / (FINER * rate)
    for i in range(blows):
        start = (i + 0.05 + 0.2 * random.random()) * n / (blows * FINER * rate)
        phase = (time - start) / (width * random.uniform(0.8, 1.2))
        inside = (phase > 0) & (phase < 1)
        force[inside] += random.uniform(0.6, 1.4) * np.sin(np.pi * phase[inside])
    return force


def multisine(period: int, periods: int, rate: float, seed: int, low: float, high: float, every: int = 1) -> np.ndarray:
    random, t = np.random.default_rng(seed), np.arange(FINER * period) / (FINER * rate)
    lines = np.arange(1, period // 2)[::every] * rate / period
    lines = lines[(lines > low) & (lines < high)]
    once = sum(np.sin(2.0 * np.pi * (f * t + random.random())) for f in lines)
    return np.tile(once / once.std(), periods)


def shaken(
    structure: Vibrating, ground: np.ndarray, rate: float, seed: int, noise: float = 0.03
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) ground acceleration and (N, dofs) absolute accelerations; every mass is one."""
    random = np.random.default_rng(20_000 + seed)
    pushed = -ground[:, None] * structure.shapes.sum(axis=0)
    a = structure.accelerations(pushed, FINER * rate) + ground[:, None]
    return noisy(random, ground[::FINER], 0.3 * noise), noisy(random, a[::FINER], noise)


@dataclass(frozen=True, eq=False)
class Measured:
    """A record.

    Attributes:
        outputs: (N, S).
        inputs: (N, F).
        rate: Hz.
        structure: That it is of.
    """

    outputs: np.ndarray
    inputs: np.ndarray
    rate: float
    structure: Vibrating


BUILDING = Vibrating.chain(1.2, [1.0, 1.0, 1.1], [0.015, 0.01, 0.02])
RIG = Vibrating.chain(7.245, [40.0, 36.0, 44.0], [0.004, 0.008, 0.01])
FRAME = Vibrating.chain(1.3, [1.0] * 4, [0.02] * 4)


def _orthogonal(frequencies: list[float], damping: list[float], dofs: int) -> "Vibrating":
    shapes, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(dofs, len(frequencies))))
    return Vibrating(np.array(frequencies), np.array(damping), shapes)


BRIDGE = _orthogonal([0.42, 0.9, 2.0, 2.08, 3.6], [0.008, 0.012, 0.01, 0.01, 0.015], 6)
AIRCRAFT = _orthogonal([5.1, 6.3, 7.2, 9.2], [0.01, 0.012, 0.02, 0.015], 5)


def _alone(outputs: np.ndarray, rate: float, structure: Vibrating) -> Measured:
    return Measured(outputs, np.zeros((len(outputs), 0)), rate, structure)


def of_building(seed: int) -> Measured:
    """Ten minutes of ambient motion."""
    return _alone(ambient(BUILDING, 600.0, 50.0, seed), 50.0, BUILDING)


def of_building_with_machines(seed: int) -> Measured:
    """The same with a drive of 1 Hz and harmonics, and one whose speed wanders a little."""
    random, a = np.random.default_rng(seed), ambient(BUILDING, 600.0, 50.0, seed)
    time, size = np.arange(len(a)) / 50.0, a.std(axis=0)
    for k, f in enumerate((1.0, 2.0, 4.1, 7.3)):
        a = a + (0.5 + 0.3 * k) * size * np.sin(2.0 * np.pi * f * time + k)[:, None] * np.array([1.0, 0.7, -0.5])
    wandering = np.cumsum(2.0 * np.pi * (9.0 + 0.03 * coloured(random, len(a), 50.0, 0.0, 0.2))) / 50.0
    return _alone(a + size * np.sin(wandering)[:, None], 50.0, BUILDING)


def of_bridge(seed: int) -> Measured:
    """Half an hour of ambient motion; two modes are close."""
    return _alone(ambient(BRIDGE, 1800.0, 20.0, seed), 20.0, BRIDGE)


def of_hammer(seed: int) -> Measured:
    """Six blows in a minute; the force is zero between them."""
    force, a = forced(RIG, hammer(30_000, 500.0, seed, 6, 0.008), 0, 500.0, seed)
    return Measured(a, force[:, None], 500.0, RIG)


def of_short_shaker(seed: int) -> Measured:
    """Fifteen seconds, of which a half-power width of the first mode has one line."""
    force, a = forced(RIG, shaker(3750, 250.0, seed, 2.0, 60.0), 0, 250.0, seed)
    return Measured(a, force[:, None], 250.0, RIG)


def of_multisine(seed: int) -> Measured:
    """Four periods, every other line between 4 and 60 Hz, at 400 Hz; three of five places."""
    force, a = forced(AIRCRAFT, multisine(8192, 4, 400.0, seed, 4.0, 60.0, 2), 0, 400.0, seed)
    return Measured(a[:, :3], force[:, None], 400.0, AIRCRAFT)


def of_drive(seed: int) -> Measured:
    """A drive of 1 Hz with its harmonics, measured."""
    force, a = forced(AIRCRAFT, multisine(400, 40, 400.0, seed, 0.5, 60.0), 0, 400.0, seed)
    return Measured(a[:, :3], force[:, None], 400.0, AIRCRAFT)


def of_ground(seed: int) -> Measured:
    """A short earthquake."""
    time = np.arange(FINER * 4000) / (FINER * 100.0)
    ground = coloured(np.random.default_rng(seed), len(time), FINER * 100.0, 0.2, 20.0)
    moved, a = shaken(FRAME, ground * np.exp(-(((time - 12.0) / 8.0) ** 2)), 100.0, seed)
    return Measured(a, moved[:, None], 100.0, FRAME)


STEPS, SETTLE = 8, 4.0


@dataclass(frozen=True, eq=False)
class Wing:
    """Natural frequencies, Hz, damping ratios and shapes over the root of the modal mass, those of the force last."""

    frequencies: np.ndarray
    ratios: np.ndarray
    shapes: np.ndarray

    @property
    def residues(self) -> np.ndarray:
        """(sensors, modes), 1/kg."""
        found: np.ndarray = self.shapes[:-1] * self.shapes[-1]
        return found


def wing(seed: int, sensors: int, frequencies: tuple[float, ...], driven: bool = True) -> Wing:
    """With a sensor where the force acts (the first one), or none; two more modes lie outside of 4 to 12 Hz."""
    rng, every = np.random.default_rng(seed), np.array([1.6, *frequencies, 15.5, 21.0])
    size = sensors + 1, len(every)
    shapes = rng.uniform(0.35, 1.0, size) * rng.choice([-1.0, 1.0], size) / np.sqrt(rng.uniform(15, 60, len(every)))
    if driven:
        shapes[-1] = shapes[0]
    return Wing(every, rng.uniform(0.005, 0.02, len(every)), shapes)


def wing_record(wing: Wing, seed: int, duration: float, rate: float = 60.0, snr_db: float = 40.0) -> np.ndarray:
    """(N, 2 + sensors): time, s, a random force, N, and accelerations, m/s^2, with noise."""
    rng, step = np.random.default_rng(1000 + seed), 1.0 / (rate * STEPS)
    count = round((duration + SETTLE) / step)
    spectrum, frequency = np.fft.rfft(rng.standard_normal(count)), np.fft.rfftfreq(count, step)
    force = np.fft.irfft(np.where((frequency > 0.3) & (frequency < 0.4 * rate), spectrum, 0.0), count)
    force *= 100.0 / force.std()
    # Straight lines between the steps have less than the force itself, the more the faster it is.
    within = np.fft.irfft(np.fft.rfft(force) / np.sinc(frequency * step) ** 2, count)
    modes = Vibrating(wing.frequencies, wing.ratios, wing.residues)
    kept = slice(round(SETTLE / step), None, STEPS)
    motion = modes.accelerations(np.tile(within, (len(wing.ratios), 1)).T, rate * STEPS)[kept]
    motion = motion + rng.standard_normal(motion.shape) * motion.std(0) * 10 ** (-snr_db / 20)
    return np.column_stack((np.arange(len(motion)) / rate, force[kept], motion))


def write_wing(record: np.ndarray, path: Path) -> Path:
    """As a file with columns t, f, a1, a2, ..."""
    names = ["t", "f", *(f"a{i + 1}" for i in range(record.shape[1] - 2))]
    np.savetxt(path, record, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    return path
