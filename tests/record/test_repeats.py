"""Repeated measurements of one response: what their mean and scatter say, and whose noise is whose."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from refusals import refusal

from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.noise import Noise, averaged
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.record.simulated import Simulated
from pinn_cli.record.simulation import Simulation
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear

SAMPLES = 2048
SEEDS = {"displacement": 43810, "velocity": 13927, "acceleration": 2024, "force": 1234}


def response() -> Response:
    time = np.linspace(0.0, 30.0, SAMPLES)
    waves = np.stack([np.sin(time), 2.0 * np.cos(3.0 * time), np.sin(5.0 * time)], axis=1)
    return Response(time, waves, 2.0 * waves, 3.0 * waves, waves * [1.0, 0.0, 1.0])


def added(noise: Noise, repeat: int) -> dict[str, np.ndarray]:
    """Quantity to the noise (N, n) of one repeat."""
    seen, clean = noise.added_to(response(), repeat), response()
    return {quantity: getattr(seen, quantity) - getattr(clean, quantity) for quantity in QUANTITIES}


def channels(noise: Noise, repeats: int) -> np.ndarray:
    """Noise of every repeat and noisy channel, one a row, in units of its own standard deviation."""
    columns = [added(noise, repeat)[quantity].T for repeat in range(repeats) for quantity in QUANTITIES]
    rows = np.concatenate(columns)
    rows = rows[rows.any(axis=1)]
    return rows / rows.std(axis=1, keepdims=True)


def test_mean_and_sum_of_squares():
    assert Noise(20.0).measured(response())[1] is None
    repeats = [Noise(20.0, seed=3, repeats=4).added_to(response(), repeat) for repeat in range(4)]
    mean, scatter = averaged(repeats)
    assert (scatter.count, scatter.samples, scatter.freedom) == (4, SAMPLES, 3 * SAMPLES)
    for quantity in QUANTITIES:
        every = [getattr(repeat, quantity) for repeat in repeats]
        np.testing.assert_allclose(getattr(mean, quantity), sum(every) / 4.0, atol=1e-14)
        square = sum(((values - getattr(mean, quantity)) ** 2).sum(axis=0) for values in every)
        np.testing.assert_allclose(scatter.square[quantity], square, rtol=1e-12)
    assert scatter.square["force"][1] == 0.0
    blind = replace(repeats[0], velocity=np.where([False, True, False], np.nan, repeats[0].velocity))
    np.testing.assert_array_equal(np.isnan(averaged([blind, blind])[1].noise_of_mean("velocity")), [0, 1, 0])


@pytest.mark.parametrize("repeats", [2, 5, 20])
def test_the_noise_of_the_mean(repeats):
    """Told by the scatter, found in the mean itself, and sigma / sqrt(R)."""
    mean, scatter = Noise(10.0, seed=1, repeats=repeats).measured(response())
    for quantity in QUANTITIES:
        clean = getattr(response(), quantity)
        noisy = clean.any(axis=0)
        expected = np.sqrt(np.mean(clean[:, noisy] ** 2, axis=0) / 10.0 / repeats)
        found = (getattr(mean, quantity) - clean)[:, noisy].std(axis=0)
        # A standard deviation from d degrees of freedom scatters by 1 / sqrt(2 d): here by four of those.
        np.testing.assert_allclose(found, expected, rtol=4.0 / np.sqrt(2.0 * SAMPLES))
        told = scatter.noise_of_mean(quantity)[noisy]
        np.testing.assert_allclose(told, expected, rtol=4.0 / np.sqrt(2.0 * scatter.freedom))


@pytest.mark.parametrize("seeds", [None, SEEDS], ids=["seed", "seeds"])
def test_independent_streams_are_independent(seeds):
    rows = channels(Noise(20.0, 5, seeds, repeats=4), 4)
    assert len(rows) == 4 * 11
    correlation = np.abs(rows @ rows.T / SAMPLES - np.eye(len(rows)))
    assert np.max(correlation) < 5.0 / np.sqrt(SAMPLES)


@pytest.mark.parametrize("seeds", [None, SEEDS], ids=["seed", "seeds"])
def test_the_first_repeat_is_the_single_measurement_of_the_same_seed(seeds):
    single, _ = Noise(20.0, 5, seeds).measured(response())
    first = Noise(20.0, 5, seeds, repeats=3).added_to(response(), 0)
    for quantity in QUANTITIES:
        np.testing.assert_array_equal(getattr(first, quantity), getattr(single, quantity))


def test_repeats_do_not_depend_on_how_many_there_are():
    few, many = (Noise(20.0, 5, repeats=count).added_to(response(), 2) for count in (3, 7))
    np.testing.assert_array_equal(few.acceleration, many.acceleration)


def test_shared_streams_are_shared_by_neighbours():
    noise = Noise(20.0, 0, SEEDS, repeats=3, repeat_streams="shared")
    for quantity in ("displacement", "velocity", "acceleration"):
        unit = np.stack([added(noise, repeat)[quantity] for repeat in range(3)])
        unit /= np.sqrt(np.mean(getattr(response(), quantity) ** 2, axis=0) / 100.0)
        # Channel 2 of repeat 1 has the noise of channel 1 of repeat 2.
        np.testing.assert_allclose(unit[0, :, 1], unit[1, :, 0], atol=1e-9)
        np.testing.assert_allclose(unit[0, :, 2], unit[1, :, 1], atol=1e-9)
        np.testing.assert_allclose(unit[0, :, 2], unit[2, :, 0], atol=1e-9)
        drawn = np.random.RandomState(SEEDS[quantity] + 3).standard_normal(SAMPLES)
        np.testing.assert_allclose(unit[1, :, 2], drawn, atol=1e-9)


def test_a_simulated_record_is_the_mean_and_knows_its_repeats():
    structure = build_chain(2, Linear(), m=10.0, c=1.0, k=15.0)
    parts = BandedNoise(2, 10.0, 129, [0.2, 1.0], 1.0, [1]), Simulation(10.0, 129)
    noise = Noise(20.0, 4, repeats=6)
    record = Simulated(*parts, noise).measure(structure).record
    mean, scatter = noise.measured(Simulated(*parts, Noise(None)).measure(structure).truth.response)
    assert (record.repeats.count, record.repeats.samples) == (6, 129)
    for quantity in QUANTITIES:
        np.testing.assert_array_equal(getattr(record, quantity), getattr(mean, quantity))
        np.testing.assert_array_equal(record.repeats.square[quantity], scatter.square[quantity])
    assert Simulated(*parts, Noise(20.0, 4)).measure(structure).record.repeats is None
    assert record.keep({"velocity": [1]}).repeats is record.repeats


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"snr_db": 20.0, "repeats": 0}, r"noise\.repeats=0"),
        ({"snr_db": 20.0, "repeats": 2.5}, r"noise\.repeats=2\.5"),
        ({"repeats": 5}, r"noise\.repeats=5: must be 1 where there is no noise"),
        ({"snr_db": 20.0, "repeats": 5, "repeat_streams": "same"}, r"noise\.repeat_streams=same"),
        ({"snr_db": 20.0, "repeats": 5, "repeat_streams": "shared"}, r"noise\.repeat_streams=shared.*noise\.seeds"),
    ],
)
def test_impossible_settings_are_named(settings, told):
    assert re.match(told, refusal(Noise, **settings))
