"""Chains of 1 to 3 storeys whose stiffnesses and dampers, and some cubic springs, are drawn from their posterior."""

from __future__ import annotations

import numpy as np
import pandas as pd

from benchmarks.trust.case import Case, defaults, record_data
from benchmarks.trust.structures import Structure, linear_motion, noisy, simulated, sinusoids


def draw(seed: int) -> Case:
    """Chains of NUTS over all parameters but the masses; starts are 20 to 50 % off."""
    rng = np.random.default_rng([seed, 110])
    n, cubic = int(rng.integers(1, 4)), bool(rng.random() < 0.4)
    mass = 10.0 ** rng.uniform(-1, 5) * rng.uniform(0.7, 1.3, n)
    shape, first = rng.uniform(0.6, 1.4, n), 10.0 ** rng.uniform(-0.5, 1.7)
    unscaled = Structure.chain(mass, k=shape)
    frequencies = unscaled.modes()[0] * first / unscaled.modes()[0][0]
    k = shape * (first / unscaled.modes()[0][0]) ** 2
    c = 2.0 * rng.uniform(0.01, 0.04) / (2.0 * np.pi * np.sqrt(frequencies[0] * frequencies[-1])) * k
    high = 1.3 * frequencies[-1]
    times = np.arange(0.0, rng.uniform(20, 40) / first, 1.0 / (rng.uniform(6, 15) * high))
    times = times[:3000]
    force = sinusoids(rng, 0.3 * first, high, 0.0981 * float(mass.mean()))
    place = np.eye(n)[int(rng.integers(n))]
    structure = Structure.chain(mass, c=c, k=k)
    motion = linear_motion(structure, lambda t: force(t)[:, None] * place, times, high)
    kappa = np.zeros(n)
    if cubic:
        spread = np.diff(motion.displacement, axis=1, prepend=0.0).var(axis=0)
        kappa = rng.uniform(0.05, 0.4, n) * k / spread
        motion = simulated(structure.hardened(kappa), lambda t: force(t) * place, times, high)
    kind = str(rng.choice(["acceleration", "acceleration", "displacement"]))
    sensors = range(n)  # the scheme needs one on every DOF
    decibel = float(rng.uniform(20, 45))
    table = {"t": times, "f": noisy(rng, force(times), float(rng.uniform(30, 50)))}
    table |= {f"y{i + 1}": noisy(rng, getattr(motion, kind)[:, i], decibel) for i in sensors}

    true = {"c": c, "k": k} | ({"kappa": kappa} if cubic else {})
    off = {name: x * rng.uniform(1.2, 1.5) ** rng.choice([-1.0, 1.0]) for name, x in true.items()}
    settings: dict[str, object] = {
        "defaults": defaults(system="duffing" if cubic else "linear", data="csv", scheme="bayesian"),
        "system": {"ndof": n, "m": mass, **off},
        "data": record_data(force={int(place.argmax()) + 1: "f"}, **{kind: {i + 1: f"y{i + 1}" for i in sensors}}),
    }
    parameters = {f"{name}_{i + 1}": float(x) for name, values in true.items() for i, x in enumerate(values)}
    truth = motion.truth(parameters, sensors)
    about = f"{n} storeys, {first:.3g} Hz, {len(times)} samples, {kind}, {decibel:.0f} dB{', cubic' if cubic else ''}"
    return Case("posterior", seed, {"record.csv": pd.DataFrame(table)}, settings, truth, about)
