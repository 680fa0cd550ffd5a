"""Beyond the end of forces that nobody measured a record says nothing of the parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from one_record import evidence_of, levels_of
from scipy.signal import butter, sosfilt

from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Record
from pinn_cli.scheme.problem import Problem, inputs_of
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.minimise import Point
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.solver import starting_noise
from pinn_cli.training.steps.beyond_forces import log_density_beyond, slope_beyond

M, C, K = 50.0, 120.0, 2e4  # 3.2 Hz
RATE, FINER, SAMPLES, END = 50.0, 8, 2000, 12.0
UNKNOWN = (Parameter("k", 0, K, 0.1 * K, unknown=True), Parameter("c", 0, C, 0.1 * C, unknown=True))


def shaken(end: float) -> Record:
    """An accelerometer on a mass under a force up to a frequency (Hz), which nobody measured."""
    rng = np.random.default_rng(0)
    force = rng.normal(size=SAMPLES * FINER)
    if end < 0.5 * RATE:
        force = sosfilt(butter(40, end, fs=FINER * RATE, output="sos"), force)
    time = np.arange(len(force)) / (FINER * RATE)
    spectrum = np.fft.rfft(force)
    s = 2j * np.pi * np.fft.rfftfreq(len(force), time[1])
    acceleration = np.fft.irfft(spectrum * s**2 / (M * s**2 + C * s + K), len(force))[::FINER, None]
    nothing = np.full_like(acceleration, np.nan)
    noisy = acceleration + 1e-3 * acceleration.std() * rng.normal(size=acceleration.shape)
    return Record(time[::FINER], nothing, nothing, noisy, np.full_like(nothing, np.nan), np.array([False]))


@pytest.fixture(scope="module", params=[END, np.inf], ids=["a band", "white"])
def solved(request):
    """A record, its evidence and its solution."""
    record, structure = shaken(request.param), build_chain(1, Linear(), m=M, c=C, k=K)
    problem = Problem(structure, record, UNKNOWN, inputs=inputs_of(structure, record))
    equations = NormalEquations(Spline().build(record), problem)
    evidence, drive = evidence_of(equations), np.array([np.sqrt(equations.refinement / FINER)])
    noise = starting_noise(equations).driven_by(drive, equations.dynamics.forces)
    return request.param, evidence, evidence.train(levels_of(noise), evidence.equations.start())


def test_the_slope_beyond_the_end_is_that_of_the_sensors_spectrum(solved):
    end, evidence, trained = solved
    std = np.sqrt(np.diag(trained.factor.corner_covariance))
    (slope,) = evidence.each_record(slope_beyond, trained, [std])
    if not np.isfinite(end):
        np.testing.assert_array_equal(slope, 0.0)
        return
    (equations,), (noise,) = evidence.equations.by_record, trained.noise.records
    inputs, values = equations.problem.inputs, equations.parameters(trained.solution.point)
    s = 2j * np.pi * np.fft.rfftfreq(SAMPLES, 1.0 / RATE)
    s = s[np.abs(s) > 2.0 * np.pi * END]
    filtered = 1.0 / ((s / inputs.force_edge) ** 2 + inputs.correlation_time * s + 1.0)
    drive = noise.innovation[-1] ** 2 / equations.refinement

    def likelihood(k: float, c: float) -> float:
        power = drive * np.abs(s**2 * filtered / (M * s**2 + c * s + k)) ** 2
        variance = float(noise.response["acceleration"][0]) ** 2
        return float(-(np.log(1.0 + power / variance) + variance / (power + variance)).sum())

    k, c, h = float(values["k"][0]), float(values["c"][0]), 1e-3
    by_k = (likelihood(k * (1 + h), c) - likelihood(k * (1 - h), c)) / (2 * h * k) * 0.1 * K
    by_c = (likelihood(k, c * (1 + h)) - likelihood(k, c * (1 - h))) / (2 * h * c) * 0.1 * C
    # The end is found within a few lines, of which one counts as much as the others.
    np.testing.assert_allclose(slope, [by_k, by_c], rtol=0.1)
    assert slope[0] < 0.0


def test_poor_sensors_tell_nothing_beyond_the_end(solved):
    _, evidence, trained = solved
    ((record_evidence, solution),) = evidence.each_record(lambda *given: given, trained)
    loud = {name: 1e4 * level for name, level in solution.noise.response.items()}
    poor = replace(solution, noise=replace(solution.noise, response=loud))
    stiffer = Point(solution.point.unknowns, solution.point.parameters + torch.tensor([1.0, 0.0], dtype=torch.float64))
    changes = [
        log_density_beyond(record_evidence, of, END, stiffer) - log_density_beyond(record_evidence, of, END, of.point)
        for of in (solution, poor)
    ]
    assert abs(changes[0]) > 0.01
    assert abs(changes[1]) < 1e-3
