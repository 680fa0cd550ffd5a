"""Buildings with a nonlinear storey in a wind that nobody measured: a force on every floor, nothing has a start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from benchmarks.trust.case import Case
from benchmarks.trust.families.nonlinear import bouc_wen, duffing
from benchmarks.trust.families.unmeasured import structure_of
from benchmarks.trust.structures import noisy, simulated
from benchmarks.trust.waves import random_waves

LAWS = (duffing, bouc_wen)


def draw(seed: int) -> Case:
    """The lowest storey is cubic with an even seed, hysteretic with an odd one; accelerometers on all floors."""
    rng = np.random.default_rng([seed, 118])
    n, law = int(rng.integers(2, 5)), LAWS[seed % 2]
    structure = structure_of(rng, n, 10.0 ** rng.uniform(-1, 6), 10.0 ** rng.uniform(-0.7, 1.2))
    first, last = structure.modes()[0][[0, -1]]
    ends = last * rng.uniform(1.2, 2.5)
    rate = ends * rng.uniform(2.3, 5.0)
    times = np.arange(0.0, min(rng.uniform(100, 200) / first, 5000 / rate), 1.0 / rate)
    # Wind grows with the height, by as much as each site has it.
    rms = 0.05 * 9.81 * structure.mass * (np.arange(1, n + 1) / n) ** rng.uniform(0.0, 1.5)
    corner = first * rng.uniform(0.5, 2.0) if rng.random() < 0.5 else np.inf
    lines = int(np.clip(2.0 * times[-1] * ends, 300, 3000))
    waves = random_waves(rng, (0.1 * first, ends), rms, lines, lambda f: 1.0 / (1.0 + (f / corner) ** 2))
    dense = np.arange(0.0, times[-1] + 1.0 / rate, 1.0 / (20.0 * ends))
    pushes = CubicSpline(dense, waves(dense))
    M, C, K = np.diag(structure.mass), structure.matrix("c"), structure.matrix("k")
    linear = waves.moves(M, C, K, np.eye(n), times)
    lowest, *others = structure.connections
    stretch, speed = (float((of @ lowest.row).std()) for of in (linear.displacement, linear.velocity))
    structure = replace(structure, connections=(law(rng, lowest, stretch, speed), *others))
    method = "LSODA" if law is bouc_wen else "DOP853"
    motion = simulated(structure, pushes, times, ends, method=method)
    decibel = rng.uniform(25, 50)
    table = {"t": times} | {f"a{i + 1}": noisy(rng, motion.acceleration[:, i], decibel) for i in range(n)}
    settings, true = structure.unknown(force=dict.fromkeys(structure.dofs), acceleration=structure.columns("a"))
    truth = motion.truth(true, range(n))
    about = (
        f"{n} storeys{', a brace' if len(structure.connections) > n else ''}, {first:.3g} to {last:.3g} Hz,"
        f" {rate:.4g} Hz x {len(times)}, {'broad-band' if corner == np.inf else 'coloured'} wind to {ends:.3g} Hz,"
        f" {rms[0] / rms[-1]:.2f} of the roof's on the first floor, {law.__name__} below, {decibel:.0f} dB"
    )
    return Case("wind", seed, {"record.csv": pd.DataFrame(table)}, settings, truth, about)
