"""What a sensor's samples say of its noise before anything is estimated."""

import numpy as np
import pytest
from independent_records import frame_record
from small_problems import excitation, measured, small_chain

from pinn_cli.record.channel import Channel
from pinn_cli.record.record import Record
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation
from pinn_cli.system.quantities import GROUND
from pinn_cli.training.sensor_samples import SensorSamples, starting_levels


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
