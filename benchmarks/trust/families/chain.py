"""Chains of 1 to 8 storeys, linear or with some cubic springs, of which all is known or the stiffnesses are not."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from benchmarks.trust.case import Case, defaults, record_data
from benchmarks.trust.structures import Structure, noise, noisy, simulated, sinusoids
from benchmarks.trust.told import Input, Sensor, Told


def draw(seed: int) -> Case:
    """Even seeds: all is known. Odd ones: stiffnesses are not, and what is prescribed is off by up to a decade."""
    rng = np.random.default_rng([seed, 101])
    n = int(rng.integers(1, 9))
    mass = 10.0 ** rng.uniform(-3, 6) * rng.uniform(0.7, 1.3, n)
    shape, first = rng.uniform(0.6, 1.4, n), 10.0 ** rng.uniform(-1, 2)
    unscaled = Structure.chain(mass, k=shape)
    k = shape * (first / unscaled.modes()[0][0]) ** 2
    frequencies = unscaled.modes()[0] * first / unscaled.modes()[0][0]
    last = frequencies[-1]
    c = 2.0 * rng.uniform(0.005, 0.03) / (2.0 * np.pi * np.sqrt(first * last)) * k
    high = first * (last / first) ** rng.uniform(0.5, 1.0) * rng.uniform(1.1, 1.5)
    dof = int(rng.integers(0, n))
    rate = 2.56 * (50.0 / 2.56) ** rng.uniform() * max(high, last)
    duration = min(rng.uniform(40, 80) / first, 12000 / rate)
    sensors = np.sort(rng.choice(n, int(rng.integers(max(1, -(-n // 3)), n + 1)), replace=False))
    kind = str(rng.choice(["acceleration"] * 3 + ["velocity", "displacement"]))
    cubic = rng.random(n) < (0.5 if rng.random() < 0.5 else 0.0)
    strength = np.where(cubic, 10.0 ** rng.uniform(-2, -0.3, n), 0.0)
    response_db, force_db = rng.uniform(10, 60), rng.uniform(20, 60)

    times, highest = np.arange(0.0, duration, 1.0 / rate), max(last, high)
    exact = sinusoids(rng, 0.3 * first, high, 0.0981 * float(mass.mean()))
    fine = np.arange(0.0, times[-1] + 1.0 / rate, 1.0 / (40.0 * highest))
    spline = CubicSpline(fine, exact(fine))
    place = np.eye(n)[dof]
    linear = Structure.chain(mass, c=c, k=k)
    motion = simulated(linear, lambda t: place * spline(t), times, highest)
    kappa = np.zeros(n)
    if cubic.any():
        spread = np.diff(motion.displacement, axis=1, prepend=0.0).var(axis=0)
        kappa = strength * k / np.maximum(spread, 1e-300)
        motion = simulated(linear.hardened(kappa), lambda t: place * spline(t), times, highest)
    table = {"t": times, "f": noisy(rng, spline(times), force_db)}
    felt = getattr(motion, kind)
    table |= {f"y{i + 1}": noisy(rng, felt[:, i], response_db) for i in sensors}

    unknown = seed % 2 == 1
    prescribed = k * 10.0 ** rng.uniform(-1, 1) * rng.uniform(0.7, 1.4, n) if unknown else k
    settings: dict[str, object] = {
        "defaults": defaults(
            system="duffing" if cubic.any() else "linear", data="csv",
            **({"scheme": "state_parameter"} if unknown else {}),
        ),
        "system": {"ndof": n, "m": mass, "c": c, "k": prescribed} | ({"kappa": kappa} if cubic.any() else {}),
        "data": record_data(force={dof + 1: "f"}, **{kind: {int(i) + 1: f"y{i + 1}" for i in sensors}}),
    }  # fmt: skip
    if unknown:
        settings["scheme"] = {"unknown": ["k_*"]}
    truth = motion.truth(linear.parameters("k") if unknown else {}, sensors)
    peer = None
    if unknown and not cubic.any():
        peer = Told.of(
            linear, {f"k_{i + 1}": float(x) for i, x in enumerate(prescribed)},
            (Input("f", noise(spline(times), force_db), place),),
            tuple(Sensor(f"y{i + 1}", kind, int(i), noise(felt[:, i], response_db)) for i in sensors),
        )  # fmt: skip
    about = (
        f"{n} storeys, {first:.3g} to {last:.3g} Hz, {rate:.4g} Hz x {len(times)},"
        f" {kind} on {[int(i) + 1 for i in sensors]},"
        f" {response_db:.0f} dB{', cubic' if cubic.any() else ''}{', k unknown' if unknown else ''}"
    )
    return Case("chain", seed, {"record.csv": pd.DataFrame(table)}, settings, truth, about, peer=peer)
