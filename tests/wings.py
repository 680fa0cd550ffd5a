"""Records of structures with many modes, by scipy alone: each mode by a first-order hold at many steps a sample."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import cont2discrete, lfilter

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
    motion = np.zeros((count, len(wing.shapes) - 1))
    # Straight lines between the steps have less than the force itself, the more the faster it is.
    within = np.fft.irfft(np.fft.rfft(force) / np.sinc(frequency * step) ** 2, count)
    for f, zeta, residue in zip(wing.frequencies, wing.ratios, wing.residues.T, strict=True):
        omega = 2 * np.pi * f
        b, a, _ = cont2discrete(([1.0, 0.0, 0.0], [1.0, 2 * zeta * omega, omega**2]), step, method="foh")
        motion += lfilter(np.ravel(b), a, within)[:, None] * residue
    kept = slice(round(SETTLE / step), None, STEPS)
    motion = motion[kept]
    motion = motion + rng.standard_normal(motion.shape) * motion.std(0) * 10 ** (-snr_db / 20)
    return np.column_stack((np.arange(len(motion)) / rate, force[kept], motion))


def write_wing(record: np.ndarray, path: Path) -> Path:
    """As a file with columns t, f, a1, a2, ..."""
    names = ["t", "f", *(f"a{i + 1}" for i in range(record.shape[1] - 2))]
    np.savetxt(path, record, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    return path
