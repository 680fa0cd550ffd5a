"""Buildings in an earthquake that nobody measured: displacements relative to the ground, nothing has a start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from benchmarks.trust.case import Case
from benchmarks.trust.families.ground import building, filtered_noise
from benchmarks.trust.families.nonlinear import bouc_wen, duffing
from benchmarks.trust.families.topology import damped
from benchmarks.trust.structures import linear_motion, noisy, simulated

LAWS = (None, duffing, bouc_wen)
# How far, dB, noise lies at least below what drifts have at the frequencies from about the highest mode on.
ABOVE = 10.0


def draw(seed: int) -> Case:
    """Of a seed's remainder by three the lowest storey is linear, cubic or hysteretic; every k and c is unknown."""
    rng = np.random.default_rng([seed, 117])
    structure = damped(rng, building(rng, 2, 5))
    n, frequencies = structure.n, structure.modes()[0]
    first, last = frequencies[0], frequencies[-1]
    ends, law = last * rng.uniform(1.1, 2.0), LAWS[seed % 3]
    rate = 2.0 * ends * rng.uniform(1.3, 4.0)
    times = np.arange(0.0, min(rng.uniform(80, 160) / first, 6000 / rate), 1.0 / rate)
    ground = filtered_noise(rng, first, ends, times[-1])
    dense = np.arange(0.0, times[-1] + 2.0 / rate, 1.0 / (20.0 * ends))
    shaken = CubicSpline(dense, ground(dense))
    motion = linear_motion(structure, lambda t: -shaken(t)[:, None] * structure.mass, times, ends)
    if law is not None:
        lowest, *others = structure.connections
        stretch, speed = (float((of @ lowest.row).std()) for of in (motion.displacement, motion.velocity))
        structure = replace(structure, connections=(law(rng, lowest, stretch, speed), *others))
        method = "LSODA" if law is bouc_wen else "DOP853"
        motion = simulated(structure, lambda t: -shaken(t) * structure.mass, times, ends, method=method)
    drifts = motion.displacement @ np.array([link.row for link in structure.connections]).T
    upper = np.abs(np.fft.rfft(drifts, axis=0))[np.fft.rfftfreq(len(times), times[1]) > 0.9 * last] ** 2
    quiet = -10.0 * np.log10(2.0 * upper.sum(axis=0).max() / len(times) ** 2 / motion.displacement.var(axis=0).max())
    decibel = max(rng.uniform(30, 60), float(quiet) + ABOVE)
    table = {"t": times} | {f"u{i + 1}": noisy(rng, motion.displacement[:, i], decibel) for i in range(n)}
    settings, true = structure.unknown(ground_acceleration="unmeasured", displacement=structure.columns("u"))
    truth = motion.truth(true, range(n))
    about = (
        f"{n} storeys{', a brace' if len(structure.connections) > n else ''}, {first:.3g} to {last:.3g} Hz,"
        f" {rate:.4g} Hz x {len(times)}, shaken to {ends:.3g} Hz, {'linear' if law is None else law.__name__} below,"
        f" {decibel:.0f} dB"
    )
    return Case("lost_ground", seed, {"record.csv": pd.DataFrame(table)}, settings, truth, about)
