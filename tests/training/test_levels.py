"""Every noise level by evidence, on records that another simulator made, and what samples say of it before."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from independent_records import IndependentRecord, frame_record, measured, storey_record
from one_record import by_spline, estimated, evidence_of, levels_of, model, of_record, residuals_of
from small_problems import QUANTITIES, accelerations, excitation, small_chain, sped_up
from small_problems import measured as small_record

from pinn_cli.network.fourier import Fourier
from pinn_cli.network.spline import Spline
from pinn_cli.record.channel import Channel
from pinn_cli.record.record import Record
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Spline as LawOfACurve
from pinn_cli.system.quantities import GROUND
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.training.levels import floor, settled, updated, values_taken
from pinn_cli.training.noise_model import FeatureProjection, NoiseModel, first_output, output_features
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.record_scales import force_and_velocity_scale
from pinn_cli.training.sensor_samples import SensorSamples, starting_levels
from pinn_cli.training.solver import starting_noise
from pinn_cli.training.steps.discrepancy_search import searched

HIGHEST = 20.0  # Hz, of the frame's force


def ratios(made: IndependentRecord, estimate: Estimate, quantity: str) -> np.ndarray:
    """Noise that was found over noise that was put in, of every sensor."""
    found = estimate.noise.sensors[quantity]
    there = made.record.sensors(quantity)
    assert np.isnan(found[~there]).all()
    return found[there] / made.noise[quantity][there]


@pytest.mark.parametrize("per_period", [2.6, *(pytest.param(rate, marks=pytest.mark.slow) for rate in (5.0, 20.0))])
def test_the_noise_of_every_sensor_is_found(per_period):
    made = frame_record(rate=per_period * HIGHEST, duration=15.0)
    estimate = estimated(made)
    np.testing.assert_allclose(ratios(made, estimate, "acceleration"), 1.0, atol=0.1)
    np.testing.assert_allclose(ratios(made, estimate, "force"), 1.0, atol=0.1)


@pytest.mark.slow
def test_pooled_sensors_have_the_noise_that_is_common():
    made, rng = frame_record(rate=100.0, duration=15.0), np.random.default_rng(8)
    acceleration = made.truth.acceleration + 0.05 * rng.standard_normal(made.truth.acceleration.shape)
    problem = Problem(model(made), replace(made.record, acceleration=acceleration))
    found = by_spline(problem, pooled=True).noise.sensors["acceleration"]
    assert len(set(found)) == 1
    assert found[0] == pytest.approx(0.05, rel=0.1)


@pytest.mark.slow
def test_a_lone_sensor_with_as_many_features_as_samples_does_not_lose_its_noise():
    """The motion could follow every sample; then the least of residuals is rounding, and no noise level."""
    made = frame_record(rate=100.0, duration=8.0, sensors=(("acceleration", (3,)),))
    problem, design = Problem(model(made), made.record), Spline(intervals=len(made.record.time))
    estimate = GaussNewton().solve(JointProblem.of(problem), design, RunContext())
    assert estimate.summary["features_per_dof"] >= len(made.record.time)
    assert 0.3 < ratios(made, estimate, "acceleration")[0] < 2.0


@pytest.mark.slow
def test_an_accelerometer_beside_a_poor_load_cell_has_the_noise_that_its_spectrum_shows():
    """The motion follows it wherever it goes, and leaves its noise for the load cell's."""
    ratio, z = [], []
    for seed in range(2):
        made = storey_record((6.0, 25.0), 400, 92.0, 20.0, 58.0, seed)
        rng, force = np.random.default_rng(50 + seed), made.truth.force
        noisy = force + 10.0 ** (-24.0 / 20.0) * force.std() * rng.standard_normal(force.shape)
        estimate = estimated(replace(made, record=replace(made.record, force=noisy)))
        ratio.append(estimate.noise.sensors["acceleration"][0] / made.noise["acceleration"][0])
        error = (estimate.response.acceleration - made.truth.acceleration) / estimate.std.acceleration
        z.append(np.sqrt((error**2).mean()))
    assert np.mean(ratio) > 0.75, ratio
    assert np.mean(z) < 1.3, z


@cache
def solved() -> tuple[Evidence, Trained, Trained]:
    """Of ten seconds, as searched and with its levels settled."""
    made = frame_record(rate=100.0, duration=10.0)
    equations = NormalEquations(Spline().build(made.record), Problem(model(made), made.record))
    evidence, noise = evidence_of(equations), levels_of(starting_noise(equations))
    trained = searched(evidence, noise, lambda: None)
    return evidence, trained, settled(evidence, trained)


def test_settled_levels_stay_where_they_are():
    evidence, trained, once = solved()
    again, (before,) = of_record(updated, evidence, once, of_record(floor, evidence, once)), once.noise.records
    np.testing.assert_allclose(again.response["acceleration"], before.response["acceleration"], rtol=0.03)
    assert again.force[2] == pytest.approx(before.force[2], rel=0.05)
    assert once.log_evidence >= trained.log_evidence


def test_the_evidence_is_greatest_at_the_levels_that_are_found():
    """The derivative by every sensor's level is MacKay's: samples less those taken up, less the residuals."""
    evidence, _, once = solved()
    point, (own,), step = once.solution.point, once.noise.records, 0.02
    (equations,) = evidence.equations.by_record

    def log_evidence(dof: int, by: float) -> float:
        level = own.response["acceleration"].copy()
        level[dof] *= np.exp(by)
        noise = levels_of(replace(own, response={**own.response, "acceleration": level}), once.noise.spread)
        return evidence.log_evidence(point, noise, evidence.equations.assemble(point, noise).factor())

    samples = len(equations.problem.record.time)
    residual = residuals_of(equations, point)["acceleration"].square().sum((0, 1)).numpy()
    taken = of_record(values_taken, evidence, once)[0]["acceleration"]
    for dof in range(3):
        slope = (log_evidence(dof, step) - log_evidence(dof, -step)) / (2.0 * step)
        chi_square = residual[dof] / own.response["acceleration"][dof] ** 2
        # Sixteen draws tell how many are taken to a few per cent of them.
        assert slope == pytest.approx(chi_square - (samples - taken[dof]), abs=0.1 * taken[dof])
        assert abs(slope) < 0.05 * samples


def test_the_scatter_of_repeats_stays_what_it_is():
    structure = small_chain()
    source = Simulated(excitation(structure), Simulation(12.0, 257), Noise(20.0, repeats=4))
    record = source.measure(structure).record.keep({"acceleration": (1, 2)})
    sensors = by_spline(Problem(structure, record)).noise.sensors
    for quantity in ("acceleration", "force"):
        there = record.sensors(quantity)
        found = sensors[quantity][there]
        np.testing.assert_allclose(found, record.repeats.noise_of_mean(quantity)[there])


@pytest.mark.slow
def test_sensors_of_one_kind_and_very_different_noise_keep_their_own():
    made = frame_record(rate=100.0, duration=15.0, snr_db=300.0)
    noisy = measured(made.structure, made.truth, {"acceleration": (1, 2, 3)}, 40.0)
    record, extra = noisy.record, 10.0 * noisy.noise["acceleration"][1]
    acceleration = record.acceleration.copy()
    acceleration[:, 1] += extra * np.random.default_rng(9).standard_normal(len(acceleration))
    worse = replace(record, acceleration=acceleration)
    sensors = by_spline(Problem(model(made), worse)).noise.sensors
    found = sensors["acceleration"] / noisy.noise["acceleration"]
    np.testing.assert_allclose(found, [1.0, np.hypot(10.0, 1.0), 1.0], rtol=0.15)


@pytest.fixture(scope="module")
def measurements():
    return small_record(small_chain(), snr_db=25.0, duration=24.0, samples=2049)


@pytest.mark.parametrize("continuity", ["exact", "penalised"])
@pytest.mark.parametrize("kind", [Spline, Fourier])
def test_a_projection_keeps_what_features_can_be(measurements, kind, continuity):
    network = kind(continuity=continuity).build(measurements.record)
    segments = network.segments(torch.as_tensor(measurements.record.time))
    output, features = first_output(network, segments), output_features(network, segments)[0]
    generator = torch.Generator().manual_seed(0)
    weights = torch.randn(network.count, 2, generator=generator, dtype=torch.float64)
    projection, grouped = FeatureProjection(network, segments), features @ weights[output.feature]
    values = output.scatter(grouped)
    scale = float(values.abs().max())
    np.testing.assert_allclose(projection.residual(values), 0.0, atol=1e-5 * scale)
    np.testing.assert_allclose(projection.sum_of_squares(grouped), values.square().sum(0), rtol=1e-6)


def test_a_projection_of_white_noise_keeps_a_share_of_features_over_samples(measurements):
    network = Spline(intervals=100).build(measurements.record)
    segments = network.segments(torch.as_tensor(measurements.record.time))
    white = torch.as_tensor(np.random.default_rng(0).normal(size=(2049, 20)))
    projection = FeatureProjection(network, segments)
    found = projection.sum_of_squares(segments.gather(white))
    assert found.mean() == pytest.approx(105, rel=0.1)
    rest = projection.residual(white)
    np.testing.assert_allclose(found + (rest**2).sum(0), white.square().sum(0), rtol=1e-6)


def test_weights_are_inverse_variances():
    levels = {q: np.array([0.5 * (i + 1), np.nan]) for i, q in enumerate(QUANTITIES)}
    noise = NoiseModel(levels, np.array([0.3, np.nan]), 0.4, 1.0)
    np.testing.assert_allclose(noise.physics_variance, [0.25, 0.16])
    for i, quantity in enumerate(QUANTITIES):
        np.testing.assert_allclose(noise.sensor_weight(quantity), [1.0 / (0.5 * (i + 1)) ** 2, 0.0])
    np.testing.assert_allclose(noise.observer_weight(np.array([10.0, 10.0])), [1 / (1.5**2 + 0.0025), 0.0])


CHAIN = small_chain()
RECORD = small_record(CHAIN, snr_db=40.0).record


def test_a_force_that_is_measured_as_zero_is_no_scale():
    silent = accelerations(replace(RECORD, force=np.zeros_like(RECORD.force)))
    assert force_and_velocity_scale(Problem(CHAIN, silent))[0] > 0


@pytest.mark.parametrize("quantity", ["force", "acceleration"])
def test_a_steady_load_is_no_scale(quantity):
    record = accelerations(RECORD) if quantity == "force" else replace(accelerations(RECORD), force=0.0 * RECORD.force)
    expected = force_and_velocity_scale(Problem(CHAIN, record))
    loaded = replace(record, **{quantity: getattr(record, quantity) + 100.0 * getattr(record, quantity).std(axis=0)})
    assert force_and_velocity_scale(Problem(CHAIN, loaded)) == pytest.approx(expected, rel=1e-9)


def test_a_velocity_goes_with_the_time_scale():
    force, velocity = force_and_velocity_scale(Problem(small_chain(speed=30.0), accelerations(sped_up(RECORD, 30.0))))
    assert (force, velocity) == pytest.approx(
        tuple(np.array(force_and_velocity_scale(Problem(CHAIN, accelerations(RECORD)))) * (1.0, 30.0))
    )


def test_noise_that_shows_is_what_was_added(measurements):
    record, truth = measurements.record, measurements.truth.response
    for quantity in (*record.response_quantities, "force"):
        added = np.std(getattr(record, quantity) - getattr(truth, quantity), axis=0)
        found, sensors = starting_levels(record, quantity), record.sensors(quantity)
        np.testing.assert_allclose(found[sensors], added[sensors], rtol=0.1)
        assert np.isnan(found[~sensors]).all()


def test_no_sensor_is_perfect():
    record = small_record(small_chain(), duration=24.0, samples=2049).record
    levels = [starting_levels(record, quantity) for quantity in record.response_quantities]
    for each in (*levels, starting_levels(record, "force")[:1]):
        assert np.all(each > 0)


def test_noise_starts_at_the_emptiest_part_of_a_spectrum_or_at_a_tenth_of_a_channel():
    made = frame_record(rate=100.0, duration=15.0)
    force = starting_levels(made.record, "force")
    for found, quantity in ((starting_levels(made.record, "acceleration"), "acceleration"), (force[2:], "force")):
        channel = getattr(made.record, quantity)[:, -len(found) :]
        true = made.noise[quantity][-len(found) :]
        assert np.all(found <= 0.1 * np.sqrt(np.mean(channel**2, axis=0)) * (1.0 + 1e-12))
        assert np.all(found > 0.5 * true)
    assert np.isnan(starting_levels(made.record, "displacement")).all()


def test_a_load_cell_with_a_gap_shows_its_noise_where_it_has_samples():
    """Without it the noise of the cell and that of an accelerometer beside it can stand in for each other."""
    rng, time = np.random.default_rng(0), 0.01 * np.arange(3000)
    shown = sum(np.cos(2.0 * np.pi * f * time + 7.0 * f) for f in np.linspace(0.5, 15.0, 60))
    shown = shown + 0.05 * rng.standard_normal(3000)
    there = (time < 12.0) | (time > 18.0)
    record = frame_record(rate=100.0, duration=15.0).record
    cell = SensorSamples(Channel("f", "force", {0: 1.0}, time[there], shown[there]), record)
    assert [cell.first, cell.shown] == pytest.approx([0.05, 0.05], rel=0.15)
    half = rng.random(3000) < 0.5
    scattered = Channel("f", "force", {0: 1.0}, time[half], shown[half])
    assert SensorSamples(scattered, record).first == pytest.approx(0.1 * np.std(scattered.measured))


@pytest.mark.parametrize("behind_filters", [False, True])
def test_content_that_ends_short_of_the_nyquist_frequency_passes_for_noise_only_behind_filters(behind_filters):
    """The ground's motion is even from 0.2 to 0.88 of the Nyquist frequency, twenty times its noise of 0.005."""
    rng, count, step = np.random.default_rng(0), 4000, 0.01
    share = np.fft.rfftfreq(count, step) / (0.5 / step)
    below = np.fft.irfft(np.where(share < 0.88, np.fft.rfft(rng.standard_normal(count)), 0.0), count)
    slow = np.fft.irfft(np.where(share < 0.2, np.fft.rfft(rng.standard_normal(count)), 0.0), count)
    ground = 10.0 * slow + 0.1 * below + 0.005 * rng.standard_normal(count)
    noise = below if behind_filters else rng.standard_normal(count)
    nothing = np.full((count, 1), np.nan)
    record = Record(
        step * np.arange(count), nothing, nothing.copy(), (20.0 * slow + 0.1 * noise)[:, None], np.zeros_like(nothing),
        np.ones(1, bool), ground_acceleration=ground,
    )  # fmt: skip
    cell = SensorSamples(record.column(GROUND, 0), record)
    assert cell.shown == pytest.approx(0.1 if behind_filters else 0.005, rel=0.15)


def test_how_rough_a_curve_is_is_what_is_most_probable():
    """Of a cubic spring that is taken for a curve that nobody has a law for."""
    plain = storey_record((0.3, 12.0), 600, 60.0, 3.0, 40.0, 3)
    size = plain.truth.displacement.std()
    made = storey_record((0.3, 12.0), 600, 60.0, 3.0, 40.0, 3, kappa=0.05 / size**2)
    law = LawOfACurve(elongation=1.1 * float(np.abs(made.truth.displacement).max()), terms=8)
    of, starts = made.structure, law.starts(float(made.structure.k[0]), float(size))
    structure = build_chain(1, law, m=of.m, c=of.c, k=of.k, **dict.fromkeys(law.parameters, 0.0))
    terms = (structure.parameter(kind, 0) for kind in law.parameters)
    uncertain = tuple(replace(p, prior_std=10.0 * starts[p.kind][-1], unknown=True) for p in terms)
    equations = NormalEquations(Spline().build(made.record), Problem(structure, made.record, uncertain))
    evidence = evidence_of(equations)
    once = settled(evidence, searched(evidence, levels_of(starting_noise(equations)), lambda: None))
    (found,) = once.noise.roughness
    assert found < 0.5
    others = [replace(once.noise, roughness=np.array([factor * found])) for factor in (1.0 / 3.0, 3.0)]
    for trained in (evidence.train(noise, once.solution.point) for noise in others):
        assert trained is not None
        assert trained.log_evidence < once.log_evidence
