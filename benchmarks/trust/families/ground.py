"""Buildings on a ground that shakes, as recorded or as filtered noise; stiffnesses and dampers unknown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.random import Generator
from scipy.interpolate import CubicSpline

from benchmarks.trust.case import Case
from benchmarks.trust.families.topology import believed, damped, guessed_system, springs_and_dampers
from benchmarks.trust.structures import Connection, Structure, linear_motion, noise, noisy, storeys, uncertainty
from benchmarks.trust.told import Input, Sensor, Told

RECORDED = Path(__file__).resolve().parents[4] / "shared" / "data" / "ground_motion"  # of people, not in the repository
PEAK = 3.0  # m/s^2

Ground = Callable[[np.ndarray], np.ndarray]


def building(rng: Generator, fewest: int, most: int) -> Structure:
    """Storeys, some with a brace over two of them; masses within a factor of 1.5, springs of 2.5; no dampers."""
    n = int(rng.integers(fewest, most + 1))
    mass = 10.0 ** rng.uniform(-1, 6) * rng.uniform(0.8, 1.2, n)
    rows = storeys(rng, n, 0.4)
    shape = rng.uniform(0.6, 1.5, len(rows)) * np.where(np.arange(len(rows)) < n, 1.0, 0.4)
    dofs = tuple(f"floor_{i + 1}" for i in range(n))
    links = (Connection(*of, values={"k": float(k)}) for of, k in zip(rows.items(), shape, strict=True))
    return Structure(dofs, mass, tuple(links)).tuned(10.0 ** rng.uniform(-1, 1.5))


def filtered_noise(rng: Generator, first: float, ends: float, duration: float) -> Ground:
    """Kanai and Tajimi's noise, with Clough and Penzien's high-pass, up to `ends` Hz, under an envelope; m/s^2."""
    soil, damping = first * 10.0 ** rng.uniform(-0.3, 0.7), rng.uniform(0.3, 0.8)
    passes = soil * rng.uniform(0.08, 0.15)
    frequency, phase = rng.uniform(0.0, ends, 500), rng.uniform(0.0, 2.0 * np.pi, 500)
    r, q = frequency / soil, frequency / passes
    power = (1.0 + (2.0 * damping * r) ** 2) / ((1.0 - r**2) ** 2 + (2.0 * damping * r) ** 2)
    power *= q**4 / ((1.0 - q**2) ** 2 + (1.2 * q) ** 2)
    amplitude = PEAK / 3.0 * np.sqrt(2.0 * power / power.sum())
    rise, strong = duration * rng.uniform(0.08, 0.2), duration * rng.uniform(0.3, 0.6)

    def ground(t: np.ndarray) -> np.ndarray:
        envelope = np.clip(t / rise, 0.0, 1.0) ** 2 * np.exp(-np.maximum(t - rise - strong, 0.0) / (0.25 * duration))
        parts = np.array_split(t, max(1, len(t) // 2000))
        waves = [np.cos(2.0 * np.pi * np.outer(part, frequency) + phase) @ amplitude for part in parts]
        return envelope * np.concatenate(waves)

    return ground


def recorded(rng: Generator, ends: float, duration: float) -> tuple[Ground, str]:
    """A recorded earthquake as a shaking table plays it: its time scaled to the duration, low-passed at `ends` Hz."""
    path = sorted(RECORDED.glob("*.csv"))[int(rng.integers(0, 3))]
    values = pd.read_csv(path).to_numpy()[:, 1]
    quiet = np.zeros(len(values) // 20)
    values = np.concatenate([quiet, values, quiet])
    frequency = np.fft.rfftfreq(len(values), duration / len(values))
    spectrum = np.fft.rfft(values) * np.clip((ends - frequency) / (0.1 * ends), 0.0, 1.0)
    fine = 16 * len(values)  # the same band, without what folds
    smooth = np.fft.irfft(np.append(spectrum, np.zeros(fine // 2 + 1 - len(spectrum))), fine)
    smooth = np.concatenate([smooth, smooth[:8]]) * PEAK / np.abs(smooth).max()
    return CubicSpline(np.arange(fine + 8) * duration / fine, smooth), path.stem


@dataclass(frozen=True)
class Shaking:
    """A ground motion and how it is sampled.

    Attributes:
        ground: Acceleration at times, m/s^2.
        ends: Where its content ends, Hz.
        times: s, (time,).
        about: A few words for people.
    """

    ground: Ground
    ends: float
    times: np.ndarray
    about: str

    def band(self) -> np.ndarray:
        """Frequencies, Hz, (2000,), as dense as the motion is strong."""
        power = np.abs(np.fft.rfft(self.ground(self.times))[1:]) ** 2
        frequency = np.fft.rfftfreq(len(self.times), self.times[1])[1:]
        return np.interp(np.linspace(0.0, 1.0, 2000), np.cumsum(power) / power.sum(), frequency)


def shaking(rng: Generator, seed: int, frequencies: np.ndarray) -> Shaking:
    """Content that ends between 0.2 and 1.0 of the Nyquist frequency, beyond the lower modes; seeds 0, 4: recorded.

    Where the records are not there, all motions are filtered noise.
    """
    first, last = frequencies[0], frequencies[-1]
    rate = 2.56 * (25.0 / 2.56) ** rng.uniform() * last
    covered = 1.1 * first * (last / first) ** 0.6
    ends = 0.5 * rate * rng.uniform(min(max(0.2, 2.0 * covered / rate), 1.0), 1.0)
    duration = min(rng.uniform(40, 80) / first, 5000 / rate)
    own = np.random.default_rng(rng.integers(2**63))  # the same case otherwise, whatever moves the ground
    if seed % 4 == 0 and RECORDED.is_dir():
        ground, name = recorded(own, ends, duration)
    else:
        ground, name = filtered_noise(own, first, ends, duration), "filtered noise"
    about = f"{name} to {2.0 * ends / rate:.2f} of Nyquist"
    return Shaking(ground, ends, np.arange(0.0, duration, 1.0 / rate), about)


def draw(seed: int) -> Case:
    """Stiffnesses begin 20 to 50 % off, dampers too or nobody says anything of them."""
    rng = np.random.default_rng([seed, 103])
    response_db, ground_db = rng.uniform(20, 60), rng.uniform(20, 60)
    ratio = 1.0 / (10.0 ** (-response_db / 10.0) + 10.0 ** (-ground_db / 10.0))
    frame = str(rng.choice(["absolute", "relative"]))
    told = False
    while not told:  # until the record can tell every stiffness
        structure = damped(rng, building(rng, 1, 7))
        n, frequencies = structure.n, structure.modes()[0]
        shaken = shaking(rng, seed, frequencies)
        sensors = np.sort(rng.choice(n, int(rng.integers(max(1, -(-n // 3)), n + 1)), replace=False))
        amount = ratio * len(shaken.times)
        told = uncertainty(structure, structure.mass[:, None], sensors, shaken.band(), amount) < 0.05
    times, a_g = shaken.times, shaken.ground(shaken.times)
    motion = linear_motion(
        structure, lambda t: -shaken.ground(t)[:, None] * structure.mass, times, max(shaken.ends, frequencies[-1])
    )
    felt = motion.acceleration + (a_g[:, None] if frame == "absolute" else 0.0)
    table = {"t": times, "g": noisy(rng, a_g, ground_db)}
    table |= {f"a{i + 1}": noisy(rng, felt[:, i], response_db) for i in sensors}
    system, nothing_said = guessed_system(rng, structure)
    channels = {
        "ground_acceleration": "g", "frame": frame,
        "acceleration": {structure.dofs[i]: f"a{i + 1}" for i in sensors},
    }  # fmt: skip
    settings = springs_and_dampers(system, channels)
    # Accelerations are reported as the sensors feel them.
    truth = replace(motion, acceleration=felt).truth(structure.parameters(), sensors)
    about = (
        f"{n} storeys{', a brace' if len(structure.connections) > n else ''}, {frequencies[0]:.3g} to"
        f" {frequencies[-1]:.3g} Hz, {1.0 / times[1]:.4g} Hz x {len(times)}, {shaken.about}, {ground_db:.0f} dB;"
        f" {frame} on {(sensors + 1).tolist()}, {response_db:.0f} dB{', c null' if nothing_said else ''}"
    )
    quantity = "absolute" if frame == "absolute" else "acceleration"
    peer = Told.of(
        structure, believed(structure, system["connections"]), (Input("g", noise(a_g, ground_db), -structure.mass),),
        tuple(Sensor(f"a{i + 1}", quantity, int(i), noise(felt[:, i], response_db)) for i in sensors),
    )  # fmt: skip
    return Case("ground", seed, {"record.csv": pd.DataFrame(table)}, settings, truth, about, peer=peer)
