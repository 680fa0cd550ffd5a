"""Structures of the family `nonlinear` whose connections lose strength and stiffness, and half of them pinch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from benchmarks.trust.case import Case
from benchmarks.trust.families import nonlinear
from benchmarks.trust.structures import Connection

# Cycles of the rms elongation over which it loses half of what it has.
HALVED_IN = (10.0, 40.0)


def draw(seed: int) -> Case:
    """Of an even seed it degrades, of an odd one it pinches as well."""
    return nonlinear.drawn_with({"degrades": degrades, "pinches": pinches}, "degrading", seed)


def degrades(rng: Generator, link: Connection, stretch: float, speed: float) -> Connection:
    """As in the family `nonlinear`, and it loses half of its strength, or of its stiffness, in 10 to 40 cycles."""
    link = nonlinear.bouc_wen(rng, link, stretch, speed)
    a, beta, gamma = (link.values[kind] for kind in ("A", "beta", "gamma"))
    cycle = 4.0 * a / (beta + gamma) * stretch  # energy
    delta_nu, delta_eta = (1.0 / (rng.uniform(*HALVED_IN) * cycle) for _ in range(2))

    def memory(e: float, v: float, z: Sequence[float]) -> list[float]:
        nu, eta = 1.0 + delta_nu * z[1], 1.0 + delta_eta * z[1]
        return [(a * v - nu * (beta * abs(v) * z[0] + gamma * v * abs(z[0]))) / eta, z[0] * v]

    values = link.values | {"delta_nu": delta_nu, "delta_eta": delta_eta}
    return replace(link, law="baber_noori", values=values, memory=memory, remembered=2)


def pinches(rng: Generator, link: Connection, stretch: float, speed: float) -> Connection:
    """The same with a slack in the middle of the loop that takes up to 40 to 80 % of its stiffness, in as long."""
    link = degrades(rng, link, stretch, speed)
    a, beta, gamma, delta_nu = (link.values[kind] for kind in ("A", "beta", "gamma", "delta_nu"))
    zeta_s, q, psi, rest = rng.uniform(0.4, 0.8), rng.uniform(0.05, 0.2), rng.uniform(0.2, 0.4), rng.uniform(0.3, 0.6)
    p, delta_psi, unpinched = 3.0 * delta_nu, 0.1 * delta_nu, link.memory
    assert unpinched is not None

    def memory(e: float, v: float, z: Sequence[float]) -> list[float]:
        rate, power = unpinched(e, v, z)
        depth = zeta_s * (1.0 - math.exp(-p * z[1]))
        width = (psi + delta_psi * z[1]) * (rest + depth)
        off = z[0] * np.sign(v) * (1.0 + delta_nu * z[1]) * (beta + gamma) / a - q
        return [rate * (1.0 - depth * math.exp(-((off / width) ** 2))), power]

    pinching = {"zeta_s": zeta_s, "q": q, "p": p, "psi": psi, "delta_psi": delta_psi, "lambda": rest}
    return replace(link, values=link.values | pinching, memory=memory)
