"""The search for the model error: what was put in is found; and the determinant that turns a motion into its forces."""

from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from one_record import evidence_of, levels_of, residuals_of, shown_noise
from scipy.interpolate import BSpline
from small_problems import QUANTITIES, excitation, measured, small_chain

from pinn_cli.network.spline import Spline
from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.record import Record
from pinn_cli.record.simulation import Simulation
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.levels import settled
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseLevels, NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.record_evidence import log_density, occupied_share, seen_powers
from pinn_cli.training.steps.discrepancy_search import scanned
from pinn_cli.training.steps.windows_discrepancy import widened

DURATION, SAMPLES, INTERVALS = 12.0, 513, 120


def disturbed(
    level: float, seed: int, nonlinearity: str = "linear", share: float = 0.9, through: str = "derivative"
) -> tuple[Evidence, NoiseLevels, float]:
    """A record with a force of rms ``level`` on every DOF that no sensor sees, over a share of the features' band."""
    structure, simulation = small_chain(nonlinearity), Simulation(DURATION, SAMPLES)
    known = excitation(structure, DURATION, SAMPLES)
    band = [0.05, share * INTERVALS / DURATION / 2.0]
    unknown = BandedNoise(3, DURATION, SAMPLES, band, level, [1, 2, 3], seed=seed)
    truth = simulation.run(structure, lambda t: known.force(t) + unknown.force(t))
    rng = np.random.default_rng(seed)
    noisy = [getattr(truth, q) + 0.003 * getattr(truth, q).std() * rng.normal(size=(SAMPLES, 3)) for q in QUANTITIES]
    force = known.force(simulation.time)
    force[:, 0] += 0.003 * rng.normal(size=SAMPLES)
    record = Record(simulation.time, *noisy, force, ~known.forced).keep({"acceleration": (1, 2, 3)})
    equations = NormalEquations(Spline(intervals=INTERVALS).build(record), Problem(structure, record, (), through))
    noise = shown_noise(record, discrepancy=1.0, continuity=1.0)
    # An average over a knot interval carries the power of its samples, less what varies within the interval: of what
    # fills the band up to f, the mean of sinc^2 up to f times the interval.
    within = np.sinc(np.linspace(0.0, band[1] * equations.network.spacing, 101))
    put_in = level * np.sqrt(SAMPLES / INTERVALS * np.mean(within**2))
    return evidence_of(equations), levels_of(noise), put_in


def found_by(evidence: Evidence, noise: NoiseLevels) -> Trained:
    """The scan's discrepancy, and all levels from there."""
    return settled(evidence, scanned(evidence, noise, 1.0, evidence.equations.start()))


DISTURBED = [
    *product((0.03, 0.2), ("linear", "duffing"), ("derivative",)),
    *product((0.05, 0.2), ("duffing",), ("observer", "both")),
]


@pytest.mark.parametrize(("level", "nonlinearity", "through"), DISTURBED)
def test_the_scan_finds_the_discrepancy_that_was_put_in(level, nonlinearity, through):
    """The observer's residual has it in its variance too: without that variance's logarithm none is too large."""
    evidence, noise, put_in = disturbed(level, 1, nonlinearity, through=through)
    best = found_by(evidence, noise)
    assert best.solution.converged
    assert 1 / 1.2 < best.noise.discrepancy / put_in < 1.2


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("level", [0.05, 0.2])
def test_the_evidence_is_greatest_at_the_discrepancy_that_was_put_in(level, seed):
    evidence, noise, put_in = disturbed(level, seed)
    ratios = np.exp(np.linspace(-0.5, 0.5, 21))
    tried = [evidence.train(noise.with_discrepancy(put_in * x), evidence.equations.start()) for x in ratios]
    assert ratios[np.argmax([t.log_evidence for t in tried])] == pytest.approx(1.0, abs=0.25)


def test_the_derivative_of_the_evidence_is_that_of_its_formula():
    evidence, noise, put_in = disturbed(0.1, 1)
    equations, (own,) = evidence.equations, evidence.equations.by_record

    middle, step = evidence.train(noise.with_discrepancy(put_in), equations.start()), 1e-3

    def log_evidence(x: float) -> float:
        """At the same motion: what no feature follows moves with it, and is not among what it makes least."""
        level, point = noise.with_discrepancy(put_in * np.exp(x)), middle.solution.point
        return evidence.log_evidence(point, level, equations.assemble(point, level).factor())

    numerical = (log_evidence(step) - log_evidence(-step)) / (2 * step)
    # Physics alone depends on the discrepancy: sum (x^2 - 1) + tr(H^-1 H_physics) per share of the discrepancy.
    (level,) = middle.noise.records
    variance, squared = level.physics_variance, level.discrepancy**2
    seen = residuals_of(own, middle.solution.point)["physics"].square().sum((0, 1)).numpy()
    share = squared / variance
    size = own.layout.size
    inverse = np.linalg.inv(dense_band(own, middle.solution.point, level))
    change = dense_band(own, middle.solution.point, level, step=1e-4)
    trace = -0.5 * np.sum(inverse * change)
    expected = float(((seen / variance - own.averages.count) * share).sum() + trace)
    assert size == len(inverse)
    assert numerical == pytest.approx(expected, rel=0.01, abs=0.5)


def dense_band(equations: NormalEquations, point, noise: NoiseModel, step: float | None = None) -> np.ndarray:
    """The Hessian, or its derivative by the logarithm of the discrepancy."""
    if step is not None:
        ends = [
            dense_band(equations, point, replace(noise, discrepancy=noise.discrepancy * np.exp(s)))
            for s in (step, -step)
        ]
        return (ends[0] - ends[1]) / (2 * step)
    return equations.assemble(point, noise).band.dense()


def test_the_evidence_prefers_the_right_stiffness():
    evidence, noise, put_in = disturbed(0.05, 1)
    right = evidence.train(noise.with_discrepancy(put_in), evidence.equations.start())
    structure, record = small_chain("linear", k=12.0), evidence.problem.alone.record
    (right_one,) = evidence.equations.by_record
    wrong = evidence_of(NormalEquations(right_one.network, Problem(structure, record)))
    # The ridge is relative to the first matrix: the same in both.
    wrong.equations.by_record[0].ridge.value = right_one.ridge.value
    assert wrong.train(noise.with_discrepancy(put_in), wrong.equations.start()).log_evidence < right.log_evidence - 10.0


def test_colour_widens_a_narrow_discrepancy_and_leaves_a_white_one():
    growth = {}
    for share in (0.1, 1.0):
        evidence, noise, _ = disturbed(0.1, 1, share=share)
        best = found_by(evidence, noise)
        growth[share] = widened(evidence, best).noise.discrepancy / best.noise.discrepancy
    assert growth[1.0] < 1.4
    assert growth[0.1] > 1.5 * growth[1.0]


@pytest.mark.parametrize("degree", [5, 6])
def test_the_band_that_is_filled_is_that_of_the_points_where_the_equations_hold(monkeypatch, degree: int):
    """Of finer points than samples the step was taken for the samples': half of the band seemed empty."""
    of_samples, _, _ = disturbed(0.1, 1)
    problem = of_samples.problem.first
    equations = NormalEquations(Spline(intervals=450, degree=degree).build(problem.record), problem)
    assert equations.refinement > 1
    time, top = equations.target.physics_time.numpy(), equations.network.free_intervals / 2.0
    rng, frequency = np.random.default_rng(0), np.arange(0.1, top, 0.1)
    phase = rng.uniform(0.0, 2.0 * np.pi, (len(frequency), 3))
    force = np.cos(2.0 * np.pi * frequency[None, :, None] * time[:, None, None] + phase).sum(axis=1)
    filled = equations.averaged(equations.physics.gather(torch.as_tensor(force)))
    monkeypatch.setattr(equations.motion, "residual", lambda point: filled)
    evidence = evidence_of(equations).records[0]
    assert occupied_share(evidence, SimpleNamespace(point=None)) > 0.7


def believed_and_unknown(start: float | None) -> tuple[Evidence, NoiseLevels]:
    """Three believed stiffnesses of a Duffing chain and, unless it starts nowhere, one unknown cubic stiffness."""
    structure = small_chain()
    believed = [Parameter("k", dof, 15.0, 1.5) for dof in range(3)]
    kappa = structure.parameters["kappa"].clone()
    unknown = []
    if start is not None:
        kappa[1] = start
        unknown = [Parameter("kappa", 1, start, 1e5, unknown=True, positive=True)]
    record = measured(structure, snr_db=50.0, duration=20.0).record.keep({"acceleration": (1, 3)})
    problem = Problem(structure.with_parameters(kappa=kappa), record, (*believed, *unknown))
    equations = NormalEquations(Spline(knots_per_period=5.0).build(record), problem)
    noise = shown_noise(record, discrepancy=1e-4, continuity=1.0)
    return evidence_of(equations, 30, 1e-8), levels_of(noise)


def test_the_spread_is_learned_from_believed_parameters_alone():
    """The update by hand, and an unknown parameter at a thousand prior deviations leaves it alone."""
    evidence, noise = believed_and_unknown(1000.0)
    trained = evidence.train(replace(noise, spread=0.5), evidence.equations.start())
    x = trained.solution.point.parameters.numpy()
    variance = np.diag(trained.factor.corner_covariance)
    determined = np.sum(1.0 - variance[:3] / 0.5**2)
    assert determined > 2.5
    expected = ((1.0 + np.sum(x[:3] ** 2)) / (1.0 + determined)) ** 0.5
    assert evidence.learned_spread(trained) == pytest.approx(expected, rel=1e-9)
    far = trained.solution.point.parameters.clone()
    far[3] = 1e3
    moved = replace(trained, solution=replace(trained.solution, point=Point(trained.solution.point.unknowns, far)))
    assert evidence.learned_spread(moved) == pytest.approx(expected, rel=1e-9)


def test_an_unknown_parameter_that_starts_ten_times_off_leaves_the_spread_alone():
    spreads = {}
    for start in (100.0, 10.0, 1000.0):
        evidence, noise = believed_and_unknown(start)
        spreads[start] = found_by(evidence, noise).noise.spread
    assert spreads[100.0] == pytest.approx((1.0 / (1.0 + 3.0)) ** 0.5, rel=0.01)  # three that are right, and the user
    for start in (10.0, 1000.0):
        assert spreads[start] == pytest.approx(spreads[100.0], rel=1e-3)


def test_with_unknown_parameters_alone_there_is_no_spread_to_learn():
    evidence, noise = believed_and_unknown(30.0)
    problem = evidence.problem.alone
    equations = NormalEquations(
        evidence.equations.by_record[0].network, replace(problem, uncertain=problem.uncertain[3:])
    )
    alone = evidence_of(equations, 30, 1e-8)
    trained = alone.train(replace(noise, spread=0.7), equations.start())
    assert alone.learned_spread(trained) == 0.7


def test_the_evidence_counts_the_spread_once_per_believed_parameter():
    """With the parameters held where they are, only the spread's own terms change."""
    evidence, noise = believed_and_unknown(100.0)
    trained = evidence.train(noise, evidence.equations.start())
    point, levels = trained.solution.point, {}
    for spread in (0.5, 2.0):
        under = replace(noise, spread=spread)
        factor = evidence.equations.assemble(point, under).factor()
        levels[spread] = evidence.log_evidence(point, under, factor) + 0.5 * (
            factor.parameter_log_determinant + sum(factor.determinants)
        )
    x = float(point.parameters[:3].square().sum())
    expected = -0.5 * x * (0.5**-2.0 - 2.0**-2.0) - 3.0 * np.log(0.5 / 2.0)
    assert levels[0.5] - levels[2.0] == pytest.approx(expected, rel=1e-6)


DEGREE = 6


def random_equations(size: int, coupled: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses, one of them nothing, dampers and springs; the last function acts on the others and does not feel them."""
    rng = np.random.default_rng(size)
    mass, there = rng.uniform(1.0, 2.0, size), rng.uniform(size=(size, size)) < coupled
    damping, stiffness = (np.eye(size) + 0.1 * there * rng.normal(size=(size, size)) for _ in range(2))
    mass[1], damping[-1, :-1], stiffness[-1, :-1] = 0.0, 0.0, 0.0
    return mass, damping, 50.0 * stiffness


@pytest.mark.parametrize("coupled", [0.2, 1.0])
@pytest.mark.parametrize("size", [2, 7, 30])
@pytest.mark.parametrize("degree", [None, DEGREE])
def test_it_is_the_determinant_at_every_frequency(degree, size, coupled):
    mass, damping, stiffness = random_equations(size, coupled)
    seen = seen_powers(300, 20.0, degree)
    zeroth, first, second = seen[..., None, None]
    dense = zeroth * stiffness + 1j * first * damping - second * np.diag(mass)
    assert log_density(mass, damping, stiffness, seen) == pytest.approx(np.linalg.slogdet(dense)[1].sum(), rel=1e-12)


def test_a_damper_adds_half_its_rate_times_the_duration():
    duration, edge, mass, k = 100.0, 400.0, np.array([2.0]), np.array([[30.0]])
    seen = seen_powers(int(duration * edge / np.pi), edge, None)
    weak, strong = (log_density(mass, np.array([[c]]), k, seen) for c in (0.1, 0.3))
    assert strong - weak == pytest.approx(0.5 * duration * 0.2 / 2.0, rel=0.01)


def equations_of_splines(c: float, k: float, intervals: int) -> np.ndarray:
    """(intervals, weights), averages of u'' + c u' + k u over knot intervals of one second."""
    knots, points = np.arange(-DEGREE, intervals + DEGREE + 1.0), (np.arange(8) + 0.5) / 8
    rows = np.zeros((intervals, intervals + DEGREE))
    for i in range(intervals):
        for j in range(i, i + DEGREE + 1):
            one = BSpline.basis_element(knots[j : j + DEGREE + 2], extrapolate=False)
            rows[i, j] = np.mean(one.derivative(2)(i + points) + c * one.derivative()(i + points) + k * one(i + points))
    return rows


@pytest.mark.parametrize("k", [1.0, 9.0, 12.0, 20.0])
def test_it_is_that_of_averaged_splines_up_to_and_beyond_their_band(k):
    """A resonance at the edge of the band, pi rad/s, and above it; the ends of the record add a little."""
    seen = seen_powers(150, np.pi, DEGREE)
    exact, found = [], []
    for stiffness in (0.25, k):
        rows = equations_of_splines(0.3, stiffness, 150)
        exact.append(np.log(np.linalg.svd(rows, compute_uv=False)).sum())
        found.append(log_density(np.ones(1), np.array([[0.3]]), np.array([[stiffness]]), seen))
    assert found[1] - found[0] == pytest.approx(exact[1] - exact[0], rel=0.04)
