"""Chains, some braced, under forces that nobody measured: on every DOF (wind) or on one; stiffness known or nearly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from benchmarks.trust.case import Case, defaults, record_data
from benchmarks.trust.structures import Connection, Structure, noise, noisy, storeys
from benchmarks.trust.told import Sensor, Told
from benchmarks.trust.waves import random_waves

UNCERTAINTY = 0.1  # relative, of k and c as they are prescribed where they are not known


def draw(seed: int) -> Case:
    """Even seeds: parameters are known. Odd ones: they are prescribed with errors, and estimated."""
    rng = np.random.default_rng([seed, 106])
    n = int(rng.integers(1, 6))
    structure = structure_of(rng, n, 10.0 ** rng.uniform(-1, 6), 10.0 ** rng.uniform(-0.7, 1.7))
    frequencies = structure.modes()[0]
    first, last = frequencies[0], frequencies[-1]
    everywhere = bool(rng.random() < 0.5)
    loaded = np.arange(n) if everywhere else np.sort(rng.choice(n, min(n, int(rng.integers(1, 3))), replace=False))
    unmeasured = loaded if everywhere else rng.choice(loaded, 1)
    coloured = bool(rng.random() < 0.5)
    high = last * rng.uniform(1.1, 1.6)
    corner = first * rng.uniform(0.5, 2.0) if coloured else np.inf
    rate = 2.56 * (20.0 / 2.56) ** rng.uniform() * high
    times = np.arange(0.0, min(rng.uniform(80, 160) / first, 8000 / rate), 1.0 / rate)
    rms = 0.02 * 9.81 * structure.mass[loaded] * 10.0 ** rng.uniform(-0.3, 0.3, len(loaded))
    lines = int(np.clip(2.0 * times[-1] * high, 300, 1500))
    waves = random_waves(rng, (0.1 * first, high), rms, lines, lambda f: 1.0 / (1.0 + (f / corner) ** 2))
    moving = everywhere or bool(rng.random() < 0.5)
    waves = replace(waves, ramp=1.0 / first, begin=-30.0 / first if moving else 0.0)
    M, C, K = np.diag(structure.mass), structure.matrix("c"), structure.matrix("k")
    motion = waves.moves(M, C, K, np.eye(n)[:, loaded], times)

    least = min(n, max(len(unmeasured), -(-n // 2)) if not everywhere else -(-n // 2))
    sensors = np.sort(rng.choice(n, int(rng.integers(least, n + 1)), replace=False))
    kind = str(rng.choice(["acceleration"] * 4 + ["velocity", "displacement"]))
    response_db, force_db = rng.uniform(20, 60), rng.uniform(30, 60)
    felt, forces = getattr(motion, kind), waves(times)
    table = {"t": times} | {f"y{i + 1}": noisy(rng, felt[:, i], response_db) for i in sensors}
    columns: dict[str, str | None] = {}
    for j, i in enumerate(loaded):
        columns[structure.dofs[i]] = None if i in unmeasured else f"f{i + 1}"
        if i not in unmeasured:
            table[f"f{i + 1}"] = noisy(rng, forces[:, j], force_db)

    uncertain = seed % 2 == 1
    prescribed = structure
    for kind_of in "ck" if uncertain else "":
        off = {link.name: link.values[kind_of] * (1.0 + UNCERTAINTY * np.clip(rng.normal(), -2.0, 2.0))
               for link in structure.connections}  # fmt: skip
        prescribed = prescribed.with_values(kind_of, off)
    settings: dict[str, object] = {
        "defaults": defaults(system="structure", data="csv"),
        "system": prescribed.settings(),
        "data": record_data(force=columns, **{kind: {structure.dofs[i]: f"y{i + 1}" for i in sensors}}),
        "scheme": {"parameter_uncertainty": UNCERTAINTY if uncertain else 0.0}
        | ({} if moving else {"initial_motion": "rest"}),
    }
    truth = motion.truth(structure.parameters() if uncertain else {}, sensors)
    peer = None
    if uncertain and everywhere:
        felt_by = tuple(Sensor(f"y{i + 1}", kind, int(i), noise(felt[:, i], response_db)) for i in sensors)
        peer = Told.of(structure, prescribed.parameters(), (), felt_by, UNCERTAINTY)
    named = "every DOF" if everywhere else f"DOF {int(unmeasured[0]) + 1} of {[int(i) + 1 for i in loaded]} loaded"
    spectrum = "coloured" if coloured else "broad-band"
    about = (
        f"{n} DOFs, {first:.3g} to {last:.3g} Hz, {rate:.4g} Hz x {len(times)}, {kind} on"
        f" {[int(i) + 1 for i in sensors]}, {response_db:.0f} dB, nobody measured {spectrum} forces on {named}"
        f"{', k and c uncertain' if uncertain else ''}"
    )
    return Case("unmeasured", seed, {"record.csv": pd.DataFrame(table)}, settings, truth, about, peer=peer)


def structure_of(rng: np.random.Generator, n: int, mass: float, first: float) -> Structure:
    """A chain of n storeys with a brace across two of them in a third of all cases; damping of 0.5 to 3 %."""
    stiff, rows = list(rng.uniform(0.6, 1.4, n)), storeys(rng, n, 0.33)
    if "brace" in rows:
        stiff.append(rng.uniform(0.1, 0.6))
    links = [Connection(*of, values={"k": float(k)}) for of, k in zip(rows.items(), stiff, strict=True)]
    unscaled = Structure(tuple(f"x{i + 1}" for i in range(n)), mass * rng.uniform(0.7, 1.3, n), tuple(links))
    found = unscaled.modes()[0]
    k = {link.name: link.values["k"] * (first / found[0]) ** 2 for link in links}
    middle = 2.0 * np.pi * first * np.sqrt(found[-1] / found[0])
    ratio = 2.0 * rng.uniform(0.005, 0.03) / middle
    c = {name: float(ratio * value * rng.uniform(0.6, 1.4)) for name, value in k.items()}
    return unscaled.with_values("k", k).with_values("c", c)
