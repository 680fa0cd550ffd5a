"""Buildings whose sensors nobody has calibrated, which feel more than one floor, or miss samples.

By the seed's remainder by four: gains and offsets; delays and drifts; strains and sums; gaps and two rates. Each of the
other three comes along in one case of four. Every channel has 20 to 60 dB, and one accelerometer has a known gain.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from numpy.random import Generator

from benchmarks.trust.buildings import Shaking, building, guessed, shaking
from benchmarks.trust.case import UNKNOWN_STRUCTURE, Case, record_data
from benchmarks.trust.structures import Motion, Structure, noisy

SUBJECTS = ("calibration", "clock", "sums", "gaps")
QUANTITIES = ("displacement", "velocity", "acceleration")
# Samples of the slower logger per period of the highest frequency, at the least.
LEAST_RATE = 2.56


@dataclass(frozen=True)
class Sensor:
    """A channel: gain * feels @ motion(t - delay) + offset + drift t, in its unit.

    Attributes:
        name: Of its column.
        setting: Of `data.channels`, what is unknown of it included.
        feels: Weights of the DOFs, (n,).
        unit: SI units that one of its units is.
        values: True `gain`, `offset`, `drift`, `delay`; offset and drift (over the whole record) over its rms.
    """

    name: str
    setting: dict[str, object]
    feels: np.ndarray
    unit: float = 1.0
    values: dict[str, float] = field(default_factory=dict)

    def unknown(self, value: float, key: str) -> Sensor:
        """With one more value that nobody knows."""
        return replace(self, setting={**self.setting, key: "unknown"}, values={**self.values, key: value})


def draw(seed: int) -> Case:
    """A building of 2 to 5 storeys; its stiffnesses are unknown, and every other time its dampers."""
    rng = np.random.default_rng([seed, 108])
    structure = building(rng, int(rng.integers(2, 6)))
    chance = rng.random(len(SUBJECTS))
    subjects = {s for i, s in enumerate(SUBJECTS) if i == seed % len(SUBJECTS) or chance[i] < 0.25}
    shaken = shaking(rng, structure, int(rng.integers(structure.n)), 3 * LEAST_RATE if "gaps" in subjects else 2.56)
    sensors = _sensors(rng, structure, subjects)
    if "calibration" in subjects:
        sensors = _uncalibrated(rng, sensors)
    if "clock" in subjects:
        sensors = _on_other_clocks(rng, sensors, shaken)
    cell = _load_cell(rng, shaken, subjects)
    table, true, motion = _measured(rng, shaken, sensors, cell)
    if "gaps" in subjects:
        _lose(rng, table, shaken)
    kinds = "k" if rng.random() < 0.5 else "kc"
    settings = {
        "defaults": UNKNOWN_STRUCTURE,
        "system": guessed(rng, structure, kinds),
        "data": record_data(channels={s.name: s.setting for s in [cell, *sensors]}),
        "scheme": {"unknown": [f"{kind}_*" for kind in kinds]},
    }
    felt = np.abs([s.feels for s in sensors]).sum(axis=0)
    truth = motion.truth(structure.parameters(kinds) | true, np.flatnonzero(felt))
    about = (
        f"{structure.n} storeys, {len(motion.displacement)} samples, {' and '.join(sorted(subjects))}: "
        + ", ".join(f"{s.name} {' '.join(s.values)}".strip() for s in [cell, *sensors])
    )
    return Case("sensors", seed, {"record.csv": pd.DataFrame(table)}, settings, truth, about)


def _sensors(rng: Generator, structure: Structure, subjects: set[str]) -> list[Sensor]:
    """A load cell and accelerometers on half of the floors to all; or on less, and gauges that feel several floors."""
    n, dofs = structure.n, structure.dofs
    sums = "sums" in subjects
    count = int(rng.integers(1, -(-n // 2) + 1) if sums else rng.integers(max(2, -(-n // 2)), n + 1))
    found = [
        Sensor(f"a{i + 1}", {"sensor": "acceleration", "dof": dofs[i]}, np.eye(n)[i])
        for i in np.sort(rng.choice(n, count, replace=False))
    ]
    if sums:
        links = structure.connections
        for i in rng.choice(len(links), int(rng.integers(1, len(links) + 1)), replace=False):
            length = 10.0 ** rng.uniform(-1, 1)  # of the column whose strain it is, m
            found.append(_sum(f"eps_{links[i].name}", "displacement", dofs, links[i].row / length, 1e-6))
        if rng.random() < 0.5:  # a sensor at an angle, or between two floors
            a, b = rng.choice(n, 2, replace=False)
            weights = rng.uniform(0.4, 1.0) * np.eye(n)[a] - rng.uniform(0.4, 1.0) * np.eye(n)[b]
            found.append(_sum("skew", str(rng.choice(QUANTITIES)), dofs, weights, 1.0))
    return found


def _load_cell(rng: Generator, shaken: Shaking, subjects: set[str]) -> Sensor:
    """Of the force, in kN now and then; on a clock of its own now and then."""
    unit = float(rng.choice([1.0, 1e3]))
    found = Sensor("f", {"sensor": "force", "dof": shaken.structure.dofs[shaken.dof], "unit": unit}, np.zeros(0), unit)
    if "clock" in subjects and rng.random() < 0.3:
        return found.unknown(float(rng.choice([-1, 1]) * rng.uniform(0.3, 4.0) * shaken.times[1]), "delay")
    return found


def _sum(name: str, quantity: str, dofs: tuple[str, ...], weights: np.ndarray, unit: float) -> Sensor:
    row = {dof: float(w) for dof, w in zip(dofs, weights, strict=True) if w}
    return Sensor(name, {"sensor": quantity, "weights": row, "unit": unit}, weights, unit)


def _uncalibrated(rng: Generator, sensors: list[Sensor]) -> list[Sensor]:
    """The first one is the reference; of the others, and of its offset, something is unknown."""
    found = []
    for i, sensor in enumerate(sensors):
        new = sensor
        if i and (i == 1 or rng.random() < 0.5):
            if rng.random() < 0.3:
                believed: dict[str, object] = {"value": 1.0, "uncertainty": 0.05}
                gain = float(np.clip(rng.normal(1.0, 0.05), 0.87, 1.13))
                new = replace(new, setting={**new.setting, "gain": believed}, values={**new.values, "gain": gain})
            else:
                new = new.unknown(float(rng.uniform(0.7, 1.4)), "gain")
        if rng.random() < 0.5:
            new = new.unknown(float(rng.choice([-1, 1]) * 10.0 ** rng.uniform(-1, 1)), "offset")
        found.append(new)
    return found


def _on_other_clocks(rng: Generator, sensors: list[Sensor], shaken: Shaking) -> list[Sensor]:
    """Each of them with a delay of a third of a sample to four, or with a drift, or as it is."""
    found = []
    for i, sensor in enumerate(sensors):
        new, step = sensor, shaken.times[1]
        if i == len(sensors) - 1 or rng.random() < 0.4:
            new = new.unknown(float(rng.choice([-1, 1]) * rng.uniform(0.3, 4.0) * step), "delay")
        if i == 0 or rng.random() < 0.3:
            new = new.unknown(float(rng.choice([-1, 1]) * rng.uniform(0.3, 3.0)), "drift")
        found.append(new)
    return found


def _measured(
    rng: Generator, shaken: Shaking, sensors: list[Sensor], cell: Sensor
) -> tuple[dict[str, np.ndarray], dict[str, float], Motion]:
    """The table, the true values of what is unknown of the sensors by name, and the motion at the samples."""
    times = shaken.times
    delays = {s.name: s.values.get("delay", 0.0) for s in sensors}
    every = np.unique(np.concatenate([times, *(times - d for d in delays.values() if d)]).clip(min=0.0))
    motion = shaken.motion(every)
    late = cell.values.get("delay", 0.0)
    force = shaken.force((times - late).clip(min=0.0)) / cell.unit
    table, true = {"t": times, "f": noisy(rng, force, rng.uniform(20, 60))}, {"delay_f": late} if late else {}
    for s in sensors:
        at = np.searchsorted(every, (times - delays[s.name]).clip(min=0.0))
        x = noisy(rng, getattr(motion, str(s.setting["sensor"]))[at] @ s.feels / s.unit, rng.uniform(20, 60))
        x = s.values.get("gain", 1.0) * x
        rms = float(x.std())
        offset, drift = s.values.get("offset", 0.0) * rms, s.values.get("drift", 0.0) * rms / times[-1]
        table[s.name] = x + offset + drift * times
        si = {"offset": s.unit * offset, "drift": s.unit * drift}  # as the program reports them
        true |= {f"{key}_{s.name}": si.get(key, value) for key, value in s.values.items()}
    at = np.searchsorted(every, times)
    seen = Motion(motion.displacement[at], motion.velocity[at], motion.acceleration[at], motion.memory[at])
    return table, true, seen


def _lose(rng: Generator, table: dict[str, np.ndarray], shaken: Shaking) -> None:
    """Channels miss stretches or single samples, or belong to a slower logger."""
    names = [name for name in table if name not in ("t", "f")]
    most = int(1.0 / (shaken.times[1] * shaken.highest * LEAST_RATE))
    for i, name in enumerate(names):
        x, what = table[name], rng.random()
        if i == 0 or what < 0.3:  # of a slower logger
            every = int(rng.integers(2, max(most, 2) + 1))
            table[name] = np.where(np.arange(len(x)) % every == int(rng.integers(every)), x, np.nan)
        elif what < 0.6:  # stretches
            for begin in rng.uniform(0.0, 0.9, int(rng.integers(1, 5))):
                place = slice(int(begin * len(x)), int((begin + rng.uniform(0.01, 0.1)) * len(x)))
                x[place] = np.nan
        elif what < 0.8:  # single samples
            x[rng.random(len(x)) < rng.uniform(0.01, 0.5)] = np.nan
