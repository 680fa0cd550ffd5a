"""Structures of 4 to 10 masses with braces, triangles, springs to the ground, and few sensors; k and c unknown."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pandas as pd
from numpy.random import Generator

from benchmarks.trust.case import UNKNOWN_STRUCTURE, Case, record_data
from benchmarks.trust.structures import Connection, Structure, linear_motion, noise, noisy, sinusoids, uncertainty
from benchmarks.trust.told import Input, Sensor, Told


def frame(rng: Generator, fewest: int, most: int) -> Structure:
    """A tree that stands on the ground, with further connections that close triangles and larger circles.

    Masses within a factor of two, springs within three; the first mode lies somewhere in 0.1 to 100 Hz. No dampers.
    """
    n = int(rng.integers(fewest, most + 1))
    mass = 10.0 ** rng.uniform(-3, 6) * rng.uniform(0.7, 1.4, n)
    below = [-1] + [i - 1 if rng.random() < 0.7 else int(rng.integers(-1, i)) for i in range(1, n)]
    joined = [(a, b) for b, a in enumerate(below)]
    free = [pair for pair in combinations(range(-1, n), 2) if pair not in joined]
    near = [pair for pair in free if _hops(joined, *pair) == 2]  # a brace across two members closes a triangle
    count = int(rng.integers(1, max(2, n // 2) + 1))
    picked = near if rng.random() < 0.7 and len(near) >= count else free
    joined += [picked[i] for i in rng.choice(len(picked), min(count, len(picked)), replace=False)]
    rows, names = [], []
    for i, (a, b) in enumerate(joined):
        row = np.zeros(n)
        row[b] = 1.0
        if a >= 0:  # some braces stand at an angle
            row[a] = -rng.uniform(0.5, 0.9) if i >= n and rng.random() < 0.3 else -1.0
        rows.append(row)
        names.append(f"member_{i + 1}" if i < n else f"brace_{i + 1 - n}")
    shape = 3.0 ** rng.uniform(-0.5, 0.5, len(rows)) * np.where(np.arange(len(rows)) < n, 1.0, 0.5)
    dofs = tuple(f"x{i + 1}" for i in range(n))
    links = (Connection(name, row, values={"k": float(k)}) for name, row, k in zip(names, rows, shape, strict=True))
    return Structure(dofs, mass, tuple(links)).tuned(10.0 ** rng.uniform(-1, 2))


def _hops(joined: list[tuple[int, int]], a: int, b: int) -> int:
    """2 if a third joint is joined to both, else 3; the ground is a joint too."""
    beside = {j: {x for pair in joined if j in pair for x in pair} - {j} for j in (a, b)}
    return 2 if beside[a] & beside[b] else 3


def damped(rng: Generator, structure: Structure) -> Structure:
    """The same with a damper beside each spring, each of its own strength, that makes 0.5 to 3 % in the modes."""
    frequencies = structure.modes()[0]
    each = 2.0 * rng.uniform(0.005, 0.03) / (2.0 * np.pi * np.sqrt(frequencies[0] * frequencies[-1]))
    c = {link.name: each * link.values["k"] * rng.uniform(0.6, 1.4) for link in structure.connections}
    return structure.with_values("c", c)


def guessed(rng: Generator, value: float) -> float:
    """What an engineer writes for what he does not know: 20 to 50 % off."""
    return value * (1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.5))


def believed(structure: Structure, connections: dict[str, dict[str, float | None]]) -> dict[str, float]:
    """Where a peer begins: what the settings say, and dampers of 2 % in the modes where they say nothing, by name."""
    ends = structure.modes()[0][[0, -1]]
    usual = 0.04 / (2.0 * np.pi * float(np.sqrt(ends.prod())))
    found = {}
    for name, values in connections.items():
        k, c = values["k"], values["c"]
        assert k is not None
        found |= {f"k_{name}": k, f"c_{name}": usual * k if c is None else c}
    return found


def guessed_system(rng: Generator, structure: Structure) -> tuple[dict[str, object], bool]:
    """`system:` with guesses of the springs, and of all dampers or of none; whether of none."""
    system, nothing_said = structure.settings(), rng.random() < 0.5
    for link in structure.connections:
        system["connections"][link.name] |= {  # type: ignore[index]
            "k": guessed(rng, link.values["k"]), "c": None if nothing_said else guessed(rng, link.values["c"]),
        }  # fmt: skip
    return system, nothing_said


def springs_and_dampers(system: dict[str, object], channels: dict[str, object]) -> dict[str, object]:
    """The experiment that finds all of them, from a record's columns by quantity and DOF."""
    return {
        "defaults": UNKNOWN_STRUCTURE,
        "system": system,
        "data": record_data(**channels),
        "scheme": {"unknown": ["k_*", "c_*"]},
    }


def draw(seed: int) -> Case:
    """One or two shakers; stiffnesses begin 20 to 50 % off, dampers too or nobody says anything of them."""
    rng = np.random.default_rng([seed, 102])
    response_db, force_db = rng.uniform(20, 60), rng.uniform(20, 60)
    ratio = 1.0 / (10.0 ** (-response_db / 10.0) + 10.0 ** (-force_db / 10.0))
    kind = str(rng.choice(["acceleration"] * 3 + ["velocity", "displacement"]))
    told = False
    while not told:  # until the record can tell every stiffness
        structure = damped(rng, frame(rng, 4, 10))
        n, frequencies = structure.n, structure.modes()[0]
        first, last = frequencies[0], frequencies[-1]
        high = first * (last / first) ** rng.uniform(0.6, 1.0) * rng.uniform(1.1, 1.5)
        highest = max(high, last)
        rate = 2.56 * (50.0 / 2.56) ** rng.uniform() * highest
        times = np.arange(0.0, min(rng.uniform(40, 80) / first, 10000 / rate), 1.0 / rate)
        sensors = np.sort(rng.choice(n, int(rng.integers(-(-n // 3), n // 2 + 1)), replace=False))
        shaken = np.sort(rng.choice(n, int(rng.choice([1, 1, 2])), replace=False))
        band = np.linspace(0.3 * first, high, 500)
        told = uncertainty(structure, np.eye(n)[:, shaken], sensors, band, ratio * len(times)) < 0.05
    shakers = [sinusoids(rng, 0.3 * first, high, 0.1 * float(structure.mass.mean())) for _ in shaken]

    def force(t: np.ndarray) -> np.ndarray:
        return np.stack([shaker(t) for shaker in shakers], axis=-1) @ np.eye(n)[shaken]

    motion, pushed = linear_motion(structure, force, times, highest), force(times)
    felt = getattr(motion, kind)
    table = {"t": times} | {f"f{i + 1}": noisy(rng, pushed[:, i], force_db) for i in shaken}
    table |= {f"y{i + 1}": noisy(rng, felt[:, i], response_db) for i in sensors}
    system, nothing_said = guessed_system(rng, structure)
    channels = {
        "force": {f"x{i + 1}": f"f{i + 1}" for i in shaken}, kind: {f"x{i + 1}": f"y{i + 1}" for i in sensors},
    }  # fmt: skip
    settings = springs_and_dampers({"damping": None} | system, channels)
    truth = motion.truth(structure.parameters(), sensors)
    peer = Told.of(
        structure, believed(structure, system["connections"]),
        tuple(Input(f"f{i + 1}", noise(pushed[:, i], force_db), np.eye(n)[i]) for i in shaken),
        tuple(Sensor(f"y{i + 1}", kind, int(i), noise(felt[:, i], response_db)) for i in sensors),
    )  # fmt: skip
    about = (
        f"{n} masses, {len(structure.connections) - n} braces, {first:.3g} to {last:.3g} Hz, {rate:.4g} Hz x"
        f" {len(times)}, {kind} on {(sensors + 1).tolist()}, {response_db:.0f} dB, force on {(shaken + 1).tolist()} to"
        f" {high:.3g} Hz, {force_db:.0f} dB{', c null' if nothing_said else ''}"
    )
    return Case("topology", seed, {"record.csv": pd.DataFrame(table)}, settings, truth, about, peer=peer)
