"""Buildings that one measured force shakes, for the families that are about sensors and about several records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.interpolate import CubicSpline

from benchmarks.trust.structures import Connection, Force, Motion, Structure, noisy, simulated, sinusoids

MOST_SAMPLES = 6000


@dataclass(frozen=True)
class Shaking:
    """A structure, the force that acts on one of its DOFs, and when it is sampled.

    Attributes:
        structure: At rest before.
        dof: From 0.
        force: N, of a time, up to a second or so behind the last sample.
        times: s, (time,).
        highest: Highest frequency of force and structure, Hz.
    """

    structure: Structure
    dof: int
    force: CubicSpline
    times: np.ndarray
    highest: float

    @property
    def acting(self) -> Force:
        """On every DOF, (n,)."""
        place = np.eye(self.structure.n)[self.dof]
        return lambda t: place * self.force(t)

    def motion(self, times: np.ndarray | None = None) -> Motion:
        """At the samples, or at times of which the first is the beginning."""
        return simulated(self.structure, self.acting, self.times if times is None else times, self.highest)


def building(rng: Generator, n: int) -> Structure:
    """Storeys `storey_1`, ... of 1 g to 1000 t and 0.1 to 100 Hz with 0.5 to 3 % damping; every other one is braced."""
    mass = 10.0 ** rng.uniform(-3, 6) * rng.uniform(0.7, 1.3, n)
    names, rows = [f"storey_{i + 1}" for i in range(n)], list(np.eye(n) - np.eye(n, k=-1))
    share = list(rng.uniform(0.6, 1.4, n))
    if n > 2 and rng.random() < 0.5:
        low = int(rng.integers(0, n - 1))  # the brace passes the floor `low`
        names.append("brace")
        rows.append(rows[low] + rows[low + 1])
        share.append(float(rng.uniform(0.2, 0.8)))
    dofs, first = tuple(f"x{i + 1}" for i in range(n)), 10.0 ** rng.uniform(-1, 2)
    links = (Connection(a, b, values={"k": x}) for a, b, x in zip(names, rows, share, strict=True))
    unscaled = Structure(dofs, mass, tuple(links))
    lowest, highest = unscaled.modes()[0][[0, -1]]
    ratio = 2.0 * rng.uniform(0.005, 0.03) / (2.0 * np.pi * first * np.sqrt(highest / lowest))
    k = np.array(share) * (first / lowest) ** 2
    links = (Connection(a, b, values={"c": ratio * x, "k": x}) for a, b, x in zip(names, rows, k.tolist(), strict=True))
    return Structure(dofs, mass, tuple(links))


def shaking(
    rng: Generator, structure: Structure, dof: int, least: float = 2.56, periods: tuple[float, float] = (40.0, 80.0)
) -> Shaking:
    """A force of a band about the modes.

    Args:
        rng: Draws band, rate and duration.
        structure: What it shakes.
        dof: Where, from 0.
        least: Samples per period of the highest frequency; up to 50.
        periods: Of the first mode: how long, from and to.
    """
    first, last = structure.modes()[0][[0, -1]]
    high = first * (last / first) ** rng.uniform(0.5, 1.0) * rng.uniform(1.1, 1.5)
    highest = float(max(last, high))
    rate = least * (50.0 / least) ** rng.uniform() * highest
    times = np.arange(0.0, min(rng.uniform(*periods) / first, MOST_SAMPLES / rate), 1.0 / rate)
    exact = sinusoids(rng, 0.3 * first, high, 0.0981 * float(structure.mass.mean()))
    fine = np.arange(0.0, times[-1] + 4.0 / rate, 1.0 / (40.0 * highest))
    return Shaking(structure, dof, CubicSpline(fine, exact(fine)), times, highest)


def guesses(rng: Generator, true: dict[str, float]) -> dict[str, float]:
    """Values that are 20 to 50 % off."""
    return {name: x * float(rng.choice([rng.uniform(0.5, 0.8), rng.uniform(1.2, 1.5)])) for name, x in true.items()}


def guessed(rng: Generator, structure: Structure, kinds: str) -> dict[str, object]:
    """`system:` with what is unknown (`k`, `c`, by letter) 20 to 50 % off."""
    for kind in kinds:
        values = {link.name: link.values[kind] for link in structure.connections}
        structure = structure.with_values(kind, guesses(rng, values))
    return structure.settings()


def columns(rng: Generator, shaken: Shaking, sensed: Sequence[int], motion: Motion) -> dict[str, np.ndarray]:
    """Table of a record: `t`, the force `f`, and accelerometers `a1`, ... on the sensed DOFs, 20 to 60 dB each."""
    table = {"t": shaken.times, "f": noisy(rng, shaken.force(shaken.times), rng.uniform(20, 60))}
    level = rng.uniform(15, 60)
    return table | {f"a{i + 1}": noisy(rng, motion.acceleration[:, i], level) for i in sensed}
