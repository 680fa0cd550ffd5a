"""Structures of 1 to 5 DOFs with one or two nonlinear connections: their parameters and some springs are unknown."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.random import Generator
from scipy.interpolate import CubicSpline

from benchmarks.trust.case import UNKNOWN_STRUCTURE, Case, record_data
from benchmarks.trust.families.unmeasured import structure_of
from benchmarks.trust.structures import Connection, noisy, simulated
from benchmarks.trust.waves import random_waves

# From a connection, its linear elongation and the rate of that, rms, to the same with a law.
Law = Callable[[Generator, Connection, float, float], Connection]
SMOOTH = {"duffing", "polynomial", "van_der_pol", "power_damping"}
STUCK = 1e-4  # part of the rms rate of a contact below which it creeps, in the simulation of one that sticks


def draw(seed: int) -> Case:
    """A seed's law is the one of its remainder by six; every other connection that is nonlinear has any law."""
    return drawn_with(LAWS, "nonlinear", seed)


def drawn_with(laws_by_name: Mapping[str, Law], family: str, seed: int) -> Case:
    """A case of such a family, with these laws."""
    rng, names = np.random.default_rng([seed, 105]), list(laws_by_name)
    n = int(rng.integers(1, 6))
    structure = structure_of(rng, n, 10.0 ** rng.uniform(-1, 6), 10.0 ** rng.uniform(-0.7, 1.7))
    first, last = structure.modes()[0][[0, -1]]
    chosen = rng.choice(len(structure.connections), int(rng.integers(1, min(n, 2) + 1)), replace=False)
    laws = [names[seed % len(names)], *rng.choice(names, len(chosen) - 1)]
    high = first * (last / first) ** rng.uniform(0.5, 1.0) * rng.uniform(1.1, 1.5)
    coarse, fine, most = (5.12, 15.0, 1500) if sharp(laws) else (2.56, 30.0, 2500)
    rate = coarse * (fine / coarse) ** rng.uniform() * max(high, last)
    times = np.arange(0.0, min(rng.uniform(40, 80) / first, most / rate), 1.0 / rate)
    dof, highest = int(rng.integers(0, n)), max(high, last)
    dense = np.arange(0.0, times[-1] + 1.0 / rate, 1.0 / (40.0 * highest))
    rms = np.array([0.1 * 9.81 * structure.mass.mean()])
    waves, place = random_waves(rng, (0.3 * first, high), rms, 300, np.ones_like), np.eye(n)[dof]
    unit = CubicSpline(dense, waves(dense)[:, 0])
    M, C, K = np.diag(structure.mass), structure.matrix("c"), structure.matrix("k")
    linear = waves.moves(M, C, K, place[:, None], times)
    size = 1.0
    if "van_der_pol" in laws:  # its elongation is measured against 1 m
        row = structure.connections[chosen[laws.index("van_der_pol")]].row
        size = rng.uniform(0.8, 1.6) / float((linear.displacement @ row).std())
    links = list(structure.connections)
    for i, law in zip(chosen, laws, strict=True):
        stretch, speed = (size * float((of @ links[i].row).std()) for of in (linear.displacement, linear.velocity))
        links[i] = laws_by_name[law](rng, links[i], stretch, speed)
    structure = replace(structure, connections=tuple(links))
    method = "LSODA" if sharp(laws) else "DOP853"
    motion = simulated(structure, lambda t: size * place * unit(t), times, highest, method=method)

    sensors = np.sort(rng.choice(n, int(rng.integers(-(-n // 2), n + 1)), replace=False))
    kind = str(rng.choice(["acceleration"] * 3 + ["velocity", "displacement"]))
    response_db, force_db = rng.uniform(20, 60), rng.uniform(30, 60)
    felt = getattr(motion, kind)
    table = {"t": times, "f": noisy(rng, size * unit(times), force_db)}
    table |= {f"y{i + 1}": noisy(rng, felt[:, i], response_db) for i in sensors}

    others = [i for i in range(len(links)) if i not in chosen]
    springs = rng.choice(others, int(rng.integers(0, len(others) + 1)), replace=False) if others else []
    unknown = {f"{kind_of}_{links[i].name}": value for i in chosen for kind_of, value in links[i].values.items()
               if kind_of not in ("c", "n")}  # fmt: skip
    unknown |= {f"k_{links[i].name}": links[i].values["k"] for i in springs}
    system = structure.settings()
    started = bool(rng.random() < 0.5)
    for i, link in enumerate(links):
        entry = system["connections"][link.name]  # type: ignore[index]
        for kind_of, value in link.values.items():
            if f"{kind_of}_{link.name}" in unknown:
                off = value * rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.5) + value
                entry[kind_of] = off if started or i not in chosen else None
    settings: dict[str, object] = {
        "defaults": UNKNOWN_STRUCTURE,
        "system": system,
        "data": record_data(
            force={structure.dofs[dof]: "f"}, **{kind: {structure.dofs[i]: f"y{i + 1}" for i in sensors}}
        ),
        "scheme": {
            "unknown": list(unknown), "initial_motion": "rest",
            "parameter_uncertainty": float(rng.choice([0.0, 0.075])),
        },
    }  # fmt: skip
    truth = motion.truth(unknown, sensors)
    bent = " and ".join(f"{law} in {links[i].name}" for i, law in zip(chosen, laws, strict=True))
    about = (
        f"{n} DOFs, {first:.3g} to {last:.3g} Hz, {rate:.4g} Hz x {len(times)}, {kind} on"
        f" {[int(i) + 1 for i in sensors]}, {response_db:.0f} dB, {bent},"
        f" {len(unknown)} unknown{'' if started else ', the laws without a start'}"
    )
    return Case(family, seed, {"record.csv": pd.DataFrame(table)}, settings, truth, about)


def sharp(laws: list[str]) -> bool:
    """Whether one of the laws has corners, which take more samples in a period, and dearer ones."""
    return not set(laws) <= SMOOTH


def duffing(rng: Generator, link: Connection, stretch: float, speed: float) -> Connection:
    """Cubic force of 2 to 50 % of the linear one."""
    kappa = 10.0 ** rng.uniform(-1.7, -0.3) * link.values["k"] / stretch**2
    return replace(link, law="duffing", values=link.values | {"kappa": kappa}, force=lambda e, v, z: kappa * e**3)


def polynomial(rng: Generator, link: Connection, stretch: float, speed: float) -> Connection:
    """A quadratic and a cubic term; the spring is the stiffer the farther it is stretched in the end."""
    k = link.values["k"]
    k_3 = rng.uniform(0.05, 0.4) * k / stretch**2
    k_2 = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.8) * np.sqrt(3.0 * k * k_3)
    return replace(
        link, law="polynomial", values=link.values | {"k_2": float(k_2), "k_3": float(k_3)},
        force=lambda e, v, z: k_2 * e**2 + k_3 * e**3,
    )  # fmt: skip


def bouc_wen(rng: Generator, link: Connection, stretch: float, speed: float) -> Connection:
    """40 to 80 % of the spring yield, at 0.5 to 2 times the elongation that the linear structure has (rms)."""
    k, part = link.values["k"], rng.uniform(0.4, 0.8)
    A, bend = part * k, 1.0 / (stretch * rng.uniform(0.5, 2.0))
    beta = bend * rng.uniform(0.5, 0.9)
    gamma = bend - beta
    return replace(
        link, law="bouc_wen", values=link.values | {"k": k - A, "A": A, "beta": beta, "gamma": gamma, "n": 1.0},
        force=lambda e, v, z: z,
        memory=lambda e, v, z: [A * v - beta * abs(v) * z[0] - gamma * v * abs(z[0])],
    )  # fmt: skip


def friction(rng: Generator, link: Connection, stretch: float, speed: float) -> Connection:
    """5 to 40 % of the spring's rms force; it sticks, or creeps below a tenth to a third of the rms rate."""
    F_c = rng.uniform(0.05, 0.4) * link.values["k"] * stretch
    creep = speed * rng.uniform(0.1, 0.3) if rng.random() < 0.5 else None
    turn = STUCK * speed if creep is None else creep
    return replace(
        link, law="friction", values=link.values | {"F_c": F_c}, options={} if creep is None else {"speed": creep},
        force=lambda e, v, z: F_c * np.tanh(v / turn),
    )  # fmt: skip


def van_der_pol(rng: Generator, link: Connection, stretch: float, speed: float) -> Connection:
    """One to five times the damper beside it: with less than 1 m of motion it feeds it."""
    mu = rng.uniform(1.0, 5.0) * link.values["c"]
    return replace(link, law="van_der_pol", values=link.values | {"mu": mu}, force=lambda e, v, z: mu * (e**2 - 1) * v)


def power_damping(rng: Generator, link: Connection, stretch: float, speed: float) -> Connection:
    """One to six times the damper beside it, at the rms rate."""
    p = float(rng.choice([1.5, 2.0, 2.0, 3.0]))
    mu = rng.uniform(1.0, 6.0) * link.values["c"] / speed ** (p - 1.0)
    return replace(
        link, law="power_damping", values=link.values | {"mu": mu}, options={"exponent": p},
        force=lambda e, v, z: mu * abs(v) ** (p - 1.0) * v,
    )  # fmt: skip


LAWS: dict[str, Law] = {
    law.__name__: law for law in (duffing, polynomial, bouc_wen, friction, van_der_pol, power_damping)
}
