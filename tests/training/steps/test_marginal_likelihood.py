"""The density of parameters under forces that nobody measured: Whittle's of a linear mass, and where forces end."""

from collections.abc import Callable
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
from pinn_cli.training.history import History
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.solver import Inference, Solver, starting_noise
from pinn_cli.training.steps.marginal_likelihood import (
    MarginalDensity,
    log_density_beyond,
    under_another_discrepancy,
)

M, C, K = 50.0, 120.0, 2e4  # 3.2 Hz
RATE, FINER, SAMPLES, END = 50.0, 8, 2000, 12.0
UNKNOWN = (Parameter("k", 0, K, 0.1 * K, unknown=True), Parameter("c", 0, C, 0.1 * C, unknown=True))


@pytest.fixture(scope="module")
def solved():
    """Of an accelerometer on a mass under a force up to a frequency, which nobody measured: evidence and a solution."""
    rng = np.random.default_rng(0)
    force = sosfilt(butter(40, END, fs=FINER * RATE, output="sos"), rng.normal(size=SAMPLES * FINER))
    time = np.arange(len(force)) / (FINER * RATE)
    s = 2j * np.pi * np.fft.rfftfreq(len(force), time[1])
    acceleration = np.fft.irfft(np.fft.rfft(force) * s**2 / (M * s**2 + C * s + K), len(force))[::FINER, None]
    nothing = np.full_like(acceleration, np.nan)
    noisy = acceleration + 1e-3 * acceleration.std() * rng.normal(size=acceleration.shape)
    record = Record(time[::FINER], nothing, nothing, noisy, np.full_like(nothing, np.nan), np.array([False]))
    structure = build_chain(1, Linear(), m=M, c=C, k=K)
    problem = Problem(structure, record, UNKNOWN, inputs=inputs_of(structure, record))
    equations = NormalEquations(Spline().build(record), problem)
    evidence, drive = evidence_of(equations), np.array([np.sqrt(equations.refinement / FINER)])
    noise = replace(starting_noise(equations), discrepancy=1e-3).driven_by(drive, equations.dynamics.forces)
    return evidence, evidence.train(levels_of(noise), evidence.equations.start())


def spectral_density(evidence, trained, inside: Callable[[np.ndarray], np.ndarray], measured: bool):
    """Whittle's log likelihood of (k, c, level of the forces) over some frequencies; of noise alone, or as measured."""
    (equations,), (noise,) = evidence.equations.by_record, trained.noise.records
    inputs, record = equations.problem.inputs, equations.problem.record
    frequency = np.fft.rfftfreq(SAMPLES, 1.0 / RATE)
    seen = np.abs(np.fft.rfft(record.acceleration[:, 0])) ** 2 / SAMPLES
    s, seen = (x[inside(frequency)] for x in (2j * np.pi * frequency, seen))
    filtered = 1.0 / ((s / inputs.force_edge) ** 2 + inputs.correlation_time * s + 1.0)
    drive, variance = noise.innovation[-1] ** 2 / equations.refinement, float(noise.response["acceleration"][0]) ** 2

    def likelihood(k: float, c: float, level: float = 1.0) -> float:
        power = variance + level**2 * drive * np.abs(s**2 * filtered / (M * s**2 + c * s + k)) ** 2
        return float(-(np.log(power / variance) + (seen if measured else variance) / power).sum())

    return likelihood


def slopes(likelihood, values, h: float = 1e-3) -> list[float]:
    """By k and c, over their prior deviations."""
    k, c = float(values["k"][0]), float(values["c"][0])
    by_k = (likelihood(k * (1 + h), c) - likelihood(k * (1 - h), c)) / (2 * h * k) * 0.1 * K
    by_c = (likelihood(k, c * (1 + h)) - likelihood(k, c * (1 - h))) / (2 * h * c) * 0.1 * C
    return [by_k, by_c]


def beyond(evidence, trained, *shift: float) -> float:
    def moved(record_evidence, solution):
        parameters = solution.point.parameters + torch.tensor(shift, dtype=torch.float64)
        there = replace(solution, point=replace(solution.point, parameters=parameters))
        return log_density_beyond(record_evidence, there, END)

    (density,) = evidence.each_record(moved, trained)
    return density


def test_beyond_the_end_it_is_that_of_the_sensors_spectrum(solved):
    evidence, trained = solved
    (equations,) = evidence.equations.by_record
    expected = slopes(
        spectral_density(evidence, trained, lambda f: f > END, measured=False),
        equations.parameters(trained.solution.point),
    )
    h = 1e-3
    slope = [
        (beyond(evidence, trained, *(h * one)) - beyond(evidence, trained, *(-h * one))) / (2.0 * h)
        for one in np.eye(2)
    ]
    # The end is found within a few lines, of which one counts as much as the others.
    np.testing.assert_allclose(slope, expected, rtol=0.1)
    assert slope[0] < 0.0


def test_poor_sensors_tell_nothing_beyond_the_end(solved):
    evidence, trained = solved
    (noise,) = trained.noise.records
    loud = {name: 1e4 * level for name, level in noise.response.items()}
    poor = replace(trained, noise=levels_of(replace(noise, response=loud)))
    changes = [beyond(evidence, of, 1.0, 0.0) - beyond(evidence, of, 0.0, 0.0) for of in (trained, poor)]
    assert abs(changes[0]) > 0.01
    assert abs(changes[1]) < 1e-3


def test_of_a_linear_mass_it_is_whittle_s(solved):
    """By the stiffness, the damper and the level of the forces, of what lies below their end."""
    evidence, trained = solved
    held = evidence.train(replace(trained.noise, held=True), trained.solution.point)
    density = MarginalDensity(evidence, held)
    slope = density.slope()
    by_parameter = np.linalg.solve(density.root.T, slope[:2])
    (equations,) = evidence.equations.by_record
    values = equations.parameters(trained.solution.point)
    likelihood = spectral_density(evidence, trained, lambda f: (f > 0.0) & (f < density.ends[0]), measured=True)
    prior, std = trained.solution.point.parameters.numpy(), np.sqrt(np.diag(held.factor.corner_covariance))
    expected = slopes(likelihood, values) - prior
    k, c, h = float(values["k"][0]), float(values["c"][0]), 1e-3
    by_level = (likelihood(k, c, 1.0 + h) - likelihood(k, c, 1.0 - h)) / (2.0 * h)
    np.testing.assert_allclose(by_parameter * std, expected * std, atol=0.3)  # in standard deviations
    # Some per cent of the values belong to the ends of the record, or to both sides of the forces' end.
    assert slope[2] / density.unit[0] == pytest.approx(by_level, abs=0.04 * SAMPLES)


def test_what_is_left_out_is_as_large_as_it_is_most_probable_and_no_part_of_the_wind(solved):
    evidence, trained = solved
    wind = trained.noise.records[0].innovation[-1]
    confused = evidence.train(replace(trained.noise.with_discrepancy(0.5 * wind), held=True), trained.solution.point)
    density = under_another_discrepancy(Inference(evidence, confused, Solver((Spline(),), History(False))))
    assert density.value > MarginalDensity(evidence, confused, density.ends).value + 1.0
    assert density.last.noise.discrepancy < 0.1 * wind
    assert density.last.noise.records[0].innovation[-1] == pytest.approx(wind, rel=0.1)


def test_no_step_leads_to_a_hysteresis_that_creates_energy(solved, monkeypatch):
    evidence, trained = solved
    held = evidence.train(replace(trained.noise, held=True), trained.solution.point)
    density = MarginalDensity(evidence, held)
    slope = density.slope()
    uphill, start = 0.3 * slope / np.linalg.norm(slope), held.solution.point.parameters
    monkeypatch.setattr(evidence, "creates_energy", lambda point: not torch.equal(point.parameters, start))
    assert not density.moved_to(uphill)
    monkeypatch.undo()
    assert density.moved_to(uphill)


def test_a_peak_on_a_bound_is_one(solved, monkeypatch):
    evidence, trained = solved
    density = MarginalDensity(evidence, evidence.train(replace(trained.noise, held=True), trained.solution.point))
    down = density.root.T @ np.array([0.0, -5.0])  # less of the damper
    free = np.concatenate((down, [0.5]))
    np.testing.assert_allclose(density.within_bounds(free), free, atol=1e-9)
    monkeypatch.setattr(evidence.equations, "lower", density.last.solution.point.parameters.numpy())
    np.testing.assert_allclose(density.within_bounds(free), [0.0, 0.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(density.within_bounds(-free), -free, atol=1e-9)
