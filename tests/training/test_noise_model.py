"""What samples say of noise before anything is estimated, orders of magnitude, and the features' own projection."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from independent_records import frame_record
from small_problems import QUANTITIES, accelerations, excitation, measured, small_chain, sped_up

from pinn_cli.network.fourier import Fourier
from pinn_cli.network.spline import Spline
from pinn_cli.record.channel import Channel
from pinn_cli.record.record import Record
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.quantities import GROUND
from pinn_cli.training.noise_model import FeatureProjection, NoiseModel, first_output, output_features
from pinn_cli.training.record_scales import force_and_velocity_scale
from pinn_cli.training.sensor_samples import SensorSamples, starting_levels


@pytest.fixture(scope="module")
def measurements():
    return measured(small_chain(), snr_db=25.0, duration=24.0, samples=2049)


@pytest.mark.parametrize("continuity", ["exact", "penalised"])
@pytest.mark.parametrize("kind", [Spline, Fourier])
def test_a_projection_keeps_what_features_can_be(measurements, kind, continuity):
    network = kind(continuity=continuity).build(measurements.record)
    segments = network.segments(torch.as_tensor(measurements.record.time))
    output, features = first_output(network, segments), output_features(network, segments)[0]
    generator = torch.Generator().manual_seed(0)
    weights = torch.randn(network.count, 2, generator=generator, dtype=torch.float64)
    projection, grouped = FeatureProjection(output, features), features @ weights[output.feature]
    values = output.scatter(grouped)
    scale = float(values.abs().max())
    np.testing.assert_allclose(projection.residual(values), 0.0, atol=1e-5 * scale)
    np.testing.assert_allclose(projection.sum_of_squares(grouped), values.square().sum(0), rtol=1e-6)


def test_a_projection_of_white_noise_keeps_a_share_of_features_over_samples(measurements):
    network = Spline(intervals=100).build(measurements.record)
    segments = network.segments(torch.as_tensor(measurements.record.time))
    white = torch.as_tensor(np.random.default_rng(0).normal(size=(2049, 20)))
    found = FeatureProjection(segments, segments.displacement).sum_of_squares(segments.gather(white))
    assert found.mean() == pytest.approx(105, rel=0.1)
    rest = FeatureProjection(segments, segments.displacement).residual(white)
    np.testing.assert_allclose(found + (rest**2).sum(0), white.square().sum(0), rtol=1e-6)


def test_weights_are_inverse_variances():
    levels = {q: np.array([0.5 * (i + 1), np.nan]) for i, q in enumerate(QUANTITIES)}
    noise = NoiseModel(levels, np.array([0.3, np.nan]), 0.4, 1.0)
    np.testing.assert_allclose(noise.physics_variance, [0.25, 0.16])
    for i, quantity in enumerate(QUANTITIES):
        np.testing.assert_allclose(noise.observation_weight(quantity, np.ones(2)), [1.0 / (0.5 * (i + 1)) ** 2, 0.0])
    np.testing.assert_allclose(
        noise.observation_weight("observer", np.array([10.0, 10.0])), [1 / (1.5**2 + 0.0025), 0.0]
    )


CHAIN = small_chain()
RECORD = measured(CHAIN, snr_db=40.0).record


def test_a_force_that_is_measured_as_zero_is_no_scale():
    silent = accelerations(replace(RECORD, force=np.zeros_like(RECORD.force)))
    assert force_and_velocity_scale(Problem(CHAIN, silent))[0] > 0


def test_a_velocity_goes_with_the_time_scale():
    force, velocity = force_and_velocity_scale(Problem(small_chain(speed=30.0), accelerations(sped_up(RECORD, 30.0))))
    assert (force, velocity) == pytest.approx(
        tuple(np.array(force_and_velocity_scale(Problem(CHAIN, accelerations(RECORD)))) * (1.0, 30.0))
    )


def test_noise_that_shows_is_what_was_added():
    measurements = measured(small_chain(), snr_db=25.0, duration=24.0, samples=2049)
    record, truth = measurements.record, measurements.truth.response
    for quantity in (*record.response_quantities, "force"):
        added = np.std(getattr(record, quantity) - getattr(truth, quantity), axis=0)
        found, sensors = starting_levels(record, quantity), record.sensors(quantity)
        np.testing.assert_allclose(found[sensors], added[sensors], rtol=0.1)
        assert np.isnan(found[~sensors]).all()


def test_no_sensor_is_perfect():
    record = measured(small_chain(), duration=24.0, samples=2049).record
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


def test_noise_is_told_by_the_scatter_of_repeats_where_there_are_any():
    structure = small_chain()
    source = Simulated(excitation(structure), Simulation(12.0, 257), Noise(20.0, repeats=4))
    record = source.measure(structure).record
    for quantity in (*record.response_quantities, "force"):
        sensors, levels = record.sensors(quantity), starting_levels(record, quantity)
        np.testing.assert_allclose(levels[sensors], record.repeats.noise_of_mean(quantity)[sensors])


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
