"""What a spline cannot follow of a motion: what is said of it, against a fit of a sine."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from independent_records import storey_record
from one_record import estimated, evidence_of, levels_of, of_record
from small_problems import measured, small_chain

from pinn_cli.network.fourier import Fourier
from pinn_cli.network.spline import Spline
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.basis import bending_at, shares_basis, term_size
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Spline as CurveOfForce
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import FeatureProjection
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.solver import starting_noise
from pinn_cli.training.steps.discrepancy_search import searched
from pinn_cli.training.steps.resolution import LARGEST_FACTOR, acceleration_error, carried_over, knots_wanted
from pinn_cli.training.steps.updated_problem import WORTHWHILE

SAMPLES, STEP, AMPLITUDE = 1201, 0.05, 2.0


def trained(evidence: Evidence, point: Point | None = None) -> Trained:
    """A solution under the first noise levels, at a point if one is given."""
    found = evidence.train(levels_of(starting_noise(evidence.equations.by_record[0])), evidence.equations.start())
    return found if point is None else replace(found, solution=replace(found.solution, point=point))


def posed(problem: Problem, design) -> Evidence:
    return evidence_of(NormalEquations(design.build(problem.record), problem))


def fitted_sine(per_period: float, degree: int = 6) -> tuple[float, float]:
    """Said and true rms error of the accelerations of a spline whose displacements are fitted to a sine."""
    structure = small_chain("linear", ndof=1)
    record = measured(structure, duration=STEP * (SAMPLES - 1), samples=SAMPLES).record.keep({"displacement": (1,)})
    points = 12
    omega = 2.0 * np.pi / (per_period * points * STEP)
    evidence = posed(Problem(structure, record), Spline(degree=degree, intervals=(SAMPLES + 1) // points))
    (equations,) = evidence.equations.by_record
    segments, time = equations.physics, equations.target.physics_time
    sine = AMPLITUDE * torch.sin(omega * time)[:, None]
    weights = FeatureProjection(equations.network, segments).coefficients(sine)
    at = trained(evidence, Point(equations.layout.unknowns(weights), torch.zeros(0, dtype=torch.float64)))
    found = equations.flat_states(segments, at.solution.point).acceleration + omega**2 * sine
    middle = slice(SAMPLES // 4, 3 * SAMPLES // 4)
    # Relative to the accelerations: the window of the spectrum keeps their mean square.
    size = omega**2 * AMPLITUDE / np.sqrt(2.0)
    assert of_record(acceleration_error, evidence, at, 0.5 * omega / (2.0 * np.pi))[0] < 1e-3 * size  # its content
    return float(of_record(acceleration_error, evidence, at)[0]) / size, float(
        found[middle].square().mean().sqrt()
    ) / size


@pytest.mark.parametrize("degree", [4, 6])
@pytest.mark.parametrize("per_period", [3.0, 4.0, 6.0])
def test_the_error_of_a_sine_is_that_of_its_image(per_period, degree):
    said, true = fitted_sine(per_period, degree)
    assert 0.5 < said / true < 2.0
    # sqrt 2: two images of the same size, above and below the knots' rate, where one is said.
    assert (1.0 / (per_period - 1.0)) ** (degree - 1) / 2.0 < said < 2.0 * (1.0 / (per_period - 1.0)) ** (degree - 1)


def test_fourier_features_have_no_images():
    structure = small_chain("linear", ndof=1)
    record = measured(structure).record.keep({"displacement": (1,)})
    evidence = posed(Problem(structure, record), Fourier(harmonics=20))
    assert not of_record(acceleration_error, evidence, trained(evidence)).any()
    assert of_record(knots_wanted, evidence, trained(evidence)) == 1.0


def wanted(snr_db: float, knots: float, unknown: bool = False) -> float:
    structure = small_chain("linear", ndof=2)
    record = measured(structure, snr_db=snr_db, duration=40.0, samples=801).record.keep({"acceleration": (1, 2)})
    uncertain = (Parameter("k", 0, 15.0, 150.0, unknown=True),) if unknown else ()
    evidence = posed(Problem(structure, record, uncertain), Spline(knots_per_period=knots))
    noise = levels_of(starting_noise(evidence.equations.by_record[0]))
    return of_record(knots_wanted, evidence, searched(evidence, noise, lambda: None))


def test_better_sensors_ask_for_more_knots():
    few = [wanted(snr_db, 2.5) for snr_db in (10.0, 40.0, 80.0)]
    assert few == sorted(few)
    assert 1.0 <= few[0] < few[-1] <= LARGEST_FACTOR


def test_enough_knots_are_enough():
    assert wanted(20.0, 8.0) < WORTHWHILE


def test_the_spline_is_finer_than_its_bands_are_wide():
    """Few samples of a poor sensor on a known stiffening storey: its motion is known better than it is measured."""
    made = storey_record((0.05, 0.2), 200, 0.57, 0.16, 23.0, 0, kappa=0.1)
    estimate = estimated(replace(made, record=replace(made.record, force=made.truth.force)))
    error = estimate.response.acceleration - made.truth.acceleration
    z = (error / estimate.std.acceleration)[:-20]  # but for the end, where nothing holds the force between its samples
    assert np.sqrt((z**2).mean()) < 2.0
    assert error.std() < 0.01 * made.truth.acceleration.std()


def test_a_motion_is_carried_over_to_finer_features():
    structure = small_chain("linear", ndof=2)
    record = measured(structure, snr_db=40.0).record.keep({"acceleration": (1, 2)})
    coarse = posed(Problem(structure, record), Spline())
    fine = posed(Problem(structure, record), Spline(least_knots=8.0))
    (few,), (many,) = coarse.equations.by_record, fine.equations.by_record
    assert many.network.count > 1.3 * few.network.count
    at = trained(coarse)
    point = carried_over(at.solution.point, few, many)
    before = few.flat_states(few.observation, at.solution.point)
    after = many.flat_states(many.observation, point)
    for one, other in zip(before[:3], after[:3], strict=True):
        middle = slice(20, -20)
        np.testing.assert_allclose(other[middle], one[middle], atol=2e-2 * float(one.abs().max()))


def test_a_curve_is_carried_over_to_other_knots():
    law, rng = CurveOfForce(elongation=1.0, terms=8), np.random.default_rng(3)
    structure = build_chain(1, law, m=1.0, c=0.2, k=15.0, **dict.fromkeys(law.parameters, 0.0))
    record = measured(small_chain("linear", ndof=1)).record.keep({"acceleration": (1,)})
    terms = tuple(replace(p, prior_std=2.0, unknown=True) for p in structure.every_parameter() if p.curve)
    problem = Problem(structure, record, terms)
    (before,) = posed(problem, Spline()).equations.by_record
    at = Point(before.start().unknowns, torch.as_tensor(rng.standard_normal(8)))
    values = {kind: x.numpy() for kind, x in before.parameters(at).items()}
    moved = problem.in_basis_of(bending_at(structure, values))
    assert not shares_basis(moved.structure, structure)
    (after,) = posed(moved, Spline()).equations.by_record
    found = {kind: x.numpy() for kind, x in after.parameters(carried_over(at, before, after)).items()}
    e = np.linspace(-1.0, 1.0, 41)[:, None]
    force = structure.connection_force(e, 0.0 * e, values)
    apart = moved.structure.connection_force(e, 0.0 * e, found) - force
    assert np.sqrt(np.mean(apart**2)) < 0.3 * np.sqrt(np.mean((force - 15.0 * e) ** 2))
    # A term may be as large as its function is smooth, whichever functions there are.
    sizes = [[term_size(one, p) for p in terms] for one in (structure, moved.structure)]
    np.testing.assert_allclose([p.prior_std for p in moved.uncertain], 2.0 * np.divide(*sizes[::-1]))
