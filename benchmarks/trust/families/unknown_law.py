"""Structures of 1 to 3 DOFs with a connection whose law nobody knows: a curve over elongation, or over speed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.random import Generator
from scipy.interpolate import CubicSpline

from benchmarks.trust.case import Case
from benchmarks.trust.families.nonlinear import duffing, power_damping
from benchmarks.trust.families.unmeasured import structure_of
from benchmarks.trust.structures import Connection, noisy, simulated
from benchmarks.trust.waves import random_waves


def backlash(rng: Generator, link: Connection, stretch: float, speed: float) -> Connection:
    """Beyond 0.7 to 1.5 times the rms elongation either way, a further spring of 0.3 to 2 times the first."""
    gap, more = stretch * rng.uniform(0.7, 1.5), link.values["k"] * rng.uniform(0.3, 2.0)
    return replace(link, force=lambda e, v, z: more * (np.maximum(e - gap, 0.0) + np.minimum(e + gap, 0.0)))


def slip(rng: Generator, link: Connection, stretch: float, speed: float) -> Connection:
    """Friction of 5 to 40 % of the spring's rms force, that turns over in 3 to 30 % of the rms rate."""
    largest, turn = rng.uniform(0.05, 0.4) * link.values["k"] * stretch, speed * 10.0 ** rng.uniform(-1.5, -0.5)
    return replace(link, force=lambda e, v, z: largest * np.tanh(v / turn))


# A law, and what its curve is over.
LAWS: tuple[tuple[Callable[[Generator, Connection, float, float], Connection], str], ...] = (
    (duffing, "elongation"),
    (backlash, "elongation"),
    (slip, "speed"),
    (power_damping, "speed"),
)


def draw(seed: int) -> Case:
    """A seed's law is the one of its remainder by four; every spring and damper is unknown and has no start."""
    rng = np.random.default_rng([seed, 119])
    make, over = LAWS[seed % len(LAWS)]
    n = int(rng.integers(1, 4))
    structure = structure_of(rng, n, 10.0 ** rng.uniform(-1, 6), 10.0 ** rng.uniform(-0.7, 1.7))
    first, last = structure.modes()[0][[0, -1]]
    high = last * rng.uniform(1.1, 1.5)
    rate = high * rng.uniform(6.0, 15.0)
    times = np.arange(0.0, min(rng.uniform(60, 120) / first, 2500 / rate), 1.0 / rate)
    dense = np.arange(0.0, times[-1] + 1.0 / rate, 1.0 / (40.0 * high))
    waves = random_waves(rng, (0.3 * first, high), np.array([0.1 * 9.81 * structure.mass.mean()]), 300, np.ones_like)
    unit, place = CubicSpline(dense, waves(dense)[:, 0]), np.eye(n)[int(rng.integers(0, n))]
    M, C, K = np.diag(structure.mass), structure.matrix("c"), structure.matrix("k")
    linear = waves.moves(M, C, K, place[:, None], times)
    links, which = list(structure.connections), int(rng.integers(0, len(structure.connections)))
    known = links[which]
    stretch, speed = (float((of @ known.row).std()) for of in (linear.displacement, linear.velocity))
    made = make(rng, known, stretch, speed)
    links[which] = made
    structure = replace(structure, connections=tuple(links))
    motion = simulated(structure, lambda t: place * unit(t), times, high, method="LSODA")
    occurs = {"elongation": motion.displacement @ made.row, "speed": motion.velocity @ made.row}
    span = float(f"{rng.uniform(1.02, 1.2) * np.abs(occurs[over]).max():.3g}")
    links[which] = replace(known, law="spline", options={over: span})
    pushed = {structure.dofs[int(place.argmax())]: "f"}
    told = replace(structure, connections=tuple(links))
    settings, true = told.unknown(force=pushed, acceleration=structure.columns("a"))

    # The spring or the damper beside a curve is the line that comes nearest to the whole over its span.
    kind, at = ("k" if over == "elongation" else "c"), np.linspace(-span, span, 20001)
    assert made.force is not None
    force = np.array([made.force(x, 0.0, 0.0) if over == "elongation" else made.force(0.0, x, 0.0) for x in at])
    true[f"{kind}_{made.name}"] += float(at @ force / (at @ at))

    response_db, force_db = rng.uniform(25, 60), rng.uniform(40, 60)
    table = {"t": times, "f": noisy(rng, unit(times), force_db)}
    table |= {f"a{i + 1}": noisy(rng, motion.acceleration[:, i], response_db) for i in range(n)}
    truth = motion.truth(true, range(n))
    about = (
        f"{n} DOFs, {first:.3g} to {last:.3g} Hz, {rate:.4g} Hz x {len(times)}, {response_db:.0f} dB,"
        f" {make.__name__} in {made.name}, of a law that nobody knows over {over}"
    )
    return Case("unknown_law", seed, {"record.csv": pd.DataFrame(table)}, settings, truth, about)
