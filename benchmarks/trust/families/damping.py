"""Structures whose damping is stated for the whole: a ratio for all modes, one for each, or Rayleigh's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.random import Generator

from benchmarks.trust.case import Case, defaults, record_data
from benchmarks.trust.families.ground import building, shaking
from benchmarks.trust.families.topology import frame, guessed
from benchmarks.trust.structures import Structure, damping_matrix, linear_motion, noisy, sinusoids, uncertainty


def chain(rng: Generator) -> Structure:
    """2 to 7 storeys, named as those of `system=linear`; no dampers."""
    n = int(rng.integers(2, 8))
    mass = 10.0 ** rng.uniform(-3, 6) * rng.uniform(0.7, 1.3, n)
    return Structure.chain(mass, dof="", k=rng.uniform(0.6, 1.4, n)).tuned(10.0 ** rng.uniform(-1, 2))


def stated(rng: Generator, structure: Structure, ends: float) -> tuple[Structure, str, dict[str, float]]:
    """The structure with damping of the whole, how it is stated (`ratio`, `ratios`, `rayleigh`), and its parameters.

    There are as many ratios as modes below `ends`, Hz; the last one is that of all further modes.
    """
    frequencies = structure.modes()[0]
    how = str(rng.choice(["ratio", "ratios", "rayleigh"]))
    if how == "rayleigh":  # the ratio is the same at the first mode and at one further up
        low, high = 2.0 * np.pi * frequencies[[0, int(rng.integers(1, structure.n))]]
        a = 2.0 * rng.uniform(0.005, 0.04) / (low + high) * np.array([low * high, 1.0])
        whole = a[0] * np.diag(structure.mass) + a[1] * structure.matrix("k")
        return replace(structure, damping=whole), how, {"a_0": float(a[0]), "a_1": float(a[1])}
    count = 1 if how == "ratio" else max(2, int((frequencies < ends).sum()))
    ratios = rng.uniform(0.005, 0.04, count)
    whole = damping_matrix(structure, np.append(ratios, np.full(structure.n, ratios[-1]))[: structure.n])
    names = ["zeta"] if how == "ratio" else [f"zeta_{i + 1}" for i in range(count)]
    return replace(structure, damping=whole), how, dict(zip(names, ratios.tolist(), strict=True))


def draw(seed: int) -> Case:
    """Chains and structures of any topology under a shaker, buildings on a ground that shakes.

    Stiffnesses are unknown, or the damping is, or both; what is unknown begins 20 to 50 % off, or without a value.
    """
    rng = np.random.default_rng([seed, 104])
    kind = str(rng.choice(["chain", "frame", "building"]))
    response_db, input_db = rng.uniform(20, 60), rng.uniform(20, 60)
    ratio = 1.0 / (10.0 ** (-response_db / 10.0) + 10.0 ** (-input_db / 10.0))
    told = False
    while not told:  # until the record can tell every stiffness
        structure = chain(rng) if kind == "chain" else frame(rng, 4, 8) if kind == "frame" else building(rng, 2, 7)
        n, frequencies = structure.n, structure.modes()[0]
        first, last = frequencies[0], frequencies[-1]
        if kind == "building":
            shaken = shaking(rng, seed, frequencies)
            times, ends, band, at = shaken.times, shaken.ends, shaken.band(), structure.mass[:, None]
        else:
            ends = first * (last / first) ** rng.uniform(0.6, 1.0) * rng.uniform(1.1, 1.5)
            rate = 2.56 * (25.0 / 2.56) ** rng.uniform() * max(ends, last)
            times = np.arange(0.0, min(rng.uniform(40, 80) / first, 8000 / rate), 1.0 / rate)
            band, at = np.linspace(0.3 * first, ends, 500), np.eye(n)[:, [int(rng.integers(0, n))]]
        structure, how, damping = stated(rng, structure, ends)
        sensors = np.sort(rng.choice(n, int(rng.integers(-(-n // 3), n + 1)), replace=False))
        highest = max(ends, last)
        told = uncertainty(structure, at, sensors, band, ratio * len(times)) < 0.05
    unknown = str(rng.choice(["stiffness", "damping", "both", "both"]))
    if kind == "building":
        ground, about = shaken.ground, shaken.about
        given, motion = ground(times), linear_motion(structure, lambda t: -ground(t)[:, None] * at.T, times, highest)
        felt, where = motion.acceleration + given[:, None], {"ground_acceleration": "input"}
    else:
        force, about = sinusoids(rng, 0.3 * first, ends, 0.1 * float(structure.mass.mean())), f"to {ends:.3g} Hz"
        given, motion = force(times), linear_motion(structure, lambda t: force(t)[:, None] * at.T, times, highest)
        felt, where = motion.acceleration, {"force": {dof(structure, int(np.argmax(at))): "input"}}
    table = {"t": times, "input": noisy(rng, given, input_db)}
    table |= {f"a{i + 1}": noisy(rng, felt[:, i], response_db) for i in sensors}
    true = structure.parameters("k") if unknown != "damping" else {}
    true |= damping if unknown != "stiffness" else {}
    settings = {
        "defaults": defaults(system="linear" if kind == "chain" else "structure", data="csv", scheme="state_parameter"),
        "system": system(rng, structure, (how, damping), unknown),
        "data": record_data(**where, acceleration={dof(structure, i): f"a{i + 1}" for i in sensors}),
        "scheme": {"unknown": list(true)},
    }
    truth = replace(motion, acceleration=felt).truth(true, sensors)
    about = (
        f"{kind} of {n}, {len(structure.connections)} springs, {first:.3g} to {last:.3g} Hz, {1.0 / times[1]:.4g} Hz x"
        f" {len(times)}, {about}, {input_db:.0f} dB; on {(sensors + 1).tolist()}, {response_db:.0f} dB; {how},"
        f" unknown: {unknown}"
    )
    return Case("damping", seed, {"record.csv": pd.DataFrame(table)}, settings, truth, about)


def dof(structure: Structure, i: int) -> object:
    """Key of a DOF in the settings: its name, or the number of a chain's."""
    name = structure.dofs[i]
    return int(name) if name.isdigit() else name


def system(
    rng: Generator, structure: Structure, stated: tuple[str, dict[str, float]], unknown: str
) -> dict[str, object]:
    """`system:` of the experiment; what is unknown is guessed, damping by somebody or by nobody."""
    how, damping = stated
    k = {link.name: link.values["k"] for link in structure.connections}
    k = k if unknown == "damping" else {name: guessed(rng, value) for name, value in k.items()}
    said: list[float | None] = list(damping.values())
    if unknown != "stiffness":
        nobody = rng.random() < 0.5
        said = [None if nobody else guessed(rng, value) for value in damping.values()]
    if structure.dofs[0].isdigit():
        own: dict[str, object] = {"ndof": structure.n, "m": structure.mass, "k": list(k.values())}
    else:
        own = structure.with_values("k", k).settings()
    return own | {
        "damping": {"rayleigh": said} if how == "rayleigh" else {"ratio": said if how == "ratios" else said[0]}
    }
