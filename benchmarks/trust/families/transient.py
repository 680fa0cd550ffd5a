"""Chains that are struck with a hammer, or pulled aside and let go: the record begins with its largest motion."""

from __future__ import annotations

import numpy as np
import pandas as pd

from benchmarks.trust.case import Case
from benchmarks.trust.families.topology import damped, guessed, springs_and_dampers
from benchmarks.trust.structures import Structure, linear_motion, noisy, simulated


def draw(seed: int) -> Case:
    """Even seeds are struck, and the blow is measured. Odd ones are let go, which nobody measures."""
    rng = np.random.default_rng([seed, 117])
    n = int(rng.integers(1, 6))
    mass = 10.0 ** rng.uniform(-1, 5) * rng.uniform(0.7, 1.4, n)
    unscaled = Structure.chain(mass, "storey_", k=rng.uniform(0.6, 1.5, n))
    structure = damped(rng, unscaled.tuned(10.0 ** rng.uniform(-0.5, 1.7)))
    frequencies, shapes = structure.modes()
    ratio = float(shapes[:, 0] @ structure.matrix("c") @ shapes[:, 0]) / (4.0 * np.pi * frequencies[0])
    last = frequencies[-1]
    rate = last * rng.uniform(4.0, 15.0)
    times = np.arange(
        0.0, min(rng.uniform(3.0, 10.0) / (2.0 * np.pi * ratio * frequencies[0]), 6000 / rate), 1.0 / rate
    )
    sensors = np.sort(rng.choice(n, (n + 1) // 2, replace=False))
    struck, response_db, blow_db = int(rng.integers(0, n)), rng.uniform(20, 50), rng.uniform(20, 50)
    table, force = {"t": times}, {}
    if seed % 2 == 0:
        begins, lasts = times[-1] * rng.uniform(0.005, 0.05), max(rng.uniform(0.2, 0.5) / last, 1.5 / rate)

        def blow(t: np.ndarray) -> np.ndarray:
            hit = np.exp(-0.5 * ((t - begins) / lasts) ** 2)
            return 10.0 * float(mass.mean()) * hit[:, None] * np.eye(n)[struck]

        motion, force = linear_motion(structure, blow, times, max(last, 0.5 / lasts)), {f"x{struck + 1}": "f"}
        table["f"] = noisy(rng, blow(times)[:, struck], blow_db)
    else:
        pulled = np.linalg.solve(structure.matrix("k"), 0.3 * float(mass.mean()) * np.eye(n)[-1])
        motion = simulated(structure, lambda _: np.zeros(n), times, last, np.concatenate((pulled, np.zeros(n))))
    table |= {f"a{i + 1}": noisy(rng, motion.acceleration[:, i], response_db) for i in sensors}
    system = structure.settings()
    for link in structure.connections:
        system["connections"][link.name] |= {  # type: ignore[index]
            kind: guessed(rng, value) for kind, value in link.values.items()
        }
    channels = {"force": force, "acceleration": {f"x{i + 1}": f"a{i + 1}" for i in sensors}}
    settings = springs_and_dampers({"damping": None} | system, channels)
    truth = motion.truth(structure.parameters(), sensors)
    about = (
        f"{n} storeys, {frequencies[0]:.3g} to {last:.3g} Hz, {100 * ratio:.2g} %, {rate:.4g} Hz x {len(times)}, on"
        f" {(sensors + 1).tolist()}, {response_db:.0f} dB, "
        + (f"struck on {struck + 1}, {blow_db:.0f} dB" if force else "let go")
    )
    return Case("transient", seed, {"record.csv": pd.DataFrame(table)}, settings, truth, about)
