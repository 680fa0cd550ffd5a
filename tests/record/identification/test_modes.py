"""Modes of simulated records whose modes are known: plain ones are found, nothing else is, and intervals hold."""

import numpy as np
import pytest
from vibrating_records import (
    BUILDING,
    RIG,
    Measured,
    Vibrating,
    ambient,
    coloured,
    of_bridge,
    of_building,
    of_building_with_machines,
    of_drive,
    of_ground,
    of_hammer,
    of_multisine,
    of_short_shaker,
)

from pinn_cli.record.identification.lines import Lines, Pole, deviations, scatter
from pinn_cli.record.identification.modes import Identified, assurance, identify, stabilisation


def look(record: Measured) -> Identified:
    return identify(record.outputs, record.inputs, 1.0 / record.rate)


def errors(found: Identified, record: Measured) -> np.ndarray:
    """(modes, 2), of the logarithms of frequency and damping ratio, over their deviations; no mode is false."""
    true = record.structure
    of = [int(np.argmin(np.abs(np.log(true.frequency / mode.frequency)))) for mode in found.modes]
    assert len(set(of)) == len(of)
    off = np.array([
        [np.log(mode.frequency / true.frequency[i]), np.log(mode.damping / true.damping[i])]
        for i, mode in zip(of, found.modes, strict=True)
    ]).reshape(-1, 2)  # fmt: skip
    assert (np.abs(off[:, 0]) < np.maximum(0.02, true.damping[of])).all()
    deviations = [np.sqrt(np.diag(mode.covariance)) for mode in found.modes]
    return off / np.array(deviations).reshape(-1, 2)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    "make", [of_building, of_building_with_machines, of_hammer, of_short_shaker, of_multisine, of_ground]
)
def test_every_plain_mode_is_found_and_no_other(make, seed):
    record = make(seed)
    found = look(record)
    off = errors(found, record)
    assert len(off) == len(record.structure.frequency)
    assert np.abs(off).max() < 4.0
    for mode, shape in zip(found.modes, record.structure.shapes.T, strict=True):
        there = shape[: record.outputs.shape[1]]
        assert assurance(mode.shape[None], there[None])[0, 0] > 0.97
        ratio = there / there[np.argmax(np.abs(mode.shape))]
        assert (np.abs(mode.shape.real - ratio) < 5.0 * deviations(mode.shape, mode.noise) + 0.02).all()


def test_machines_are_named_as_what_they_are():
    found = look(of_building_with_machines(0))
    np.testing.assert_allclose(found.machines, [1.0, 2.0, 4.1, 7.3, 9.0], rtol=5e-3)


@pytest.mark.parametrize("seed", [2, 3, 7])
def test_a_mode_is_found_whose_damping_is_hardly_known(seed):
    """Three lines in a half-power width, 320 periods: its frequency is known to a part of a hundred and fifty."""
    light = Vibrating.chain(1.6, [1.3, 1.2, 1.1, 1.0], [0.005, 0.012, 0.02, 0.025])
    values = ambient(light, 200.0, 25.0, seed)
    record = Measured(values, values[:, :0], 25.0, light)
    found = look(record)
    off = errors(found, record)
    assert len(off) == 4
    assert np.abs(off).max() < 4.0
    assert found.modes[0].frequency_std < 1.6 / 150
    lower, upper = found.modes[0].damping_interval
    assert upper > 9.0 * lower


@pytest.mark.parametrize("seed", [0, 1])
def test_close_modes_are_told_apart(seed):
    record = of_bridge(seed)
    assert len(errors(look(record), record)) == 5


@pytest.mark.parametrize("seed", [0, 1])
def test_harmonics_of_a_measured_drive_are_no_modes(seed):
    record = of_drive(seed)
    errors(look(record), record)


@pytest.mark.parametrize("inputs", [0, 1])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_noise_has_no_modes(inputs, seed):
    noise = np.random.default_rng(seed).normal(size=(6000, 3))
    assert not look(Measured(noise[:, inputs:], noise[:, :inputs], 50.0, BUILDING)).modes
    assert stabilisation(0.0 * noise, noise[:, :0], 0.01).clusters() == []


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_edges_of_a_band_and_drifts_are_no_modes(seed):
    random = np.random.default_rng(seed)
    banded = np.stack([coloured(random, 12_000, 100.0, 0.5, 8.0) for _ in range(3)], axis=1)
    walk = np.cumsum(random.normal(size=(12_000, 3)), axis=0)
    for values in (banded + 0.05 * random.normal(size=banded.shape), walk + random.normal(size=walk.shape)):
        assert not look(Measured(values, values[:, :0], 100.0, BUILDING)).modes


def test_where_the_input_has_no_power_no_mode_is_taken_from_it():
    """A shaker between 15 and 40 Hz; noise of the load cell is all that there is at the first mode."""
    random = np.random.default_rng(0)
    record = of_hammer(0)
    force = coloured(random, len(record.outputs), record.rate, 15.0, 40.0)
    noise = random.normal(size=record.outputs.shape)
    answers = np.stack([np.convolve(force, [1.0, -0.4, gain], mode="same") for gain in (0.1, 0.2, 0.3)], axis=1)
    assert not look(Measured(answers + 0.1 * noise, force[:, None], record.rate, record.structure)).modes


def test_few_samples_and_one_sensor():
    """A short record of one sensor does not fail; nothing is said of modes that it has not seen for some periods."""
    a = ambient(BUILDING, 4.0, 50.0, 0)[:, :1]
    assert all(mode.frequency > 2.0 for mode in identify(a, a[:, :0], 0.02).modes)


def test_more_sensors_than_are_taken():
    record = of_building(0)
    random = np.random.default_rng(0)
    mixed = record.outputs @ random.normal(size=(3, 40))
    found = identify(mixed + 0.1 * mixed.std(axis=0) * random.normal(size=mixed.shape), record.inputs, 0.02)
    assert len(found.modes) == 3
    assert all(np.count_nonzero(mode.shape) == 40 for mode in found.modes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "count"),
    [
        *[(make, 20) for make in (of_building, of_bridge, of_short_shaker, of_multisine, of_ground)],
        (of_hammer, 40),
    ],
)
def test_intervals_hold_the_true_modes(make, count):
    """90 % intervals of frequencies and damping ratios, of so many records; modes that are missed, and false ones."""
    records = [make(100 + seed) for seed in range(count)]
    off = [errors(look(record), record) for record in records]
    assert sum(map(len, off)) >= 0.97 * sum(len(record.structure.frequency) for record in records)
    held = np.mean(np.abs(np.concatenate(off)) < 1.6449, axis=0)
    assert (held > 0.8).all()
    assert (held <= 0.99).all()


@pytest.mark.parametrize(("make", "structure"), [(of_building, BUILDING), (of_hammer, RIG)])
def test_stable_poles_are_those_of_the_structure(make, structure):
    record = make(0)
    clusters = stabilisation(record.outputs, record.inputs, 1.0 / record.rate).clusters()
    found = np.array([[f, damping] for f, damping, _ in clusters])
    for f, shape in zip(structure.frequency, structure.shapes.T, strict=True):
        nearest = int(np.argmin(np.abs(found[:, 0] - f)))
        assert found[nearest, 0] == pytest.approx(f, rel=5e-3)
        assert assurance(clusters[nearest][2][None], shape[None])[0, 0] > 0.95


def test_adjacent_lines_of_a_wide_band_count_together():
    assert scatter(np.ones((90, 1))) == pytest.approx(270.0)  # thirty groups of three
    assert scatter(np.ones((40, 1))) == pytest.approx(40.0)  # each line alone
    assert scatter((-1.0) ** np.arange(120)[:, None]) == pytest.approx(0.0)


def test_tones_are_told_from_what_fills_a_band():
    random, at = np.random.default_rng(0), 0.97 * np.arange(1, 13)
    t = np.arange(6000) / 50.0
    played = np.cos(2.0 * np.pi * at * t[:, None] + random.uniform(0.0, 6.0, 12)).sum(axis=1) + 0.02 * random.normal(
        size=6000
    )
    inputs = np.stack((played, random.normal(size=6000), (t > 3.0) * np.exp(-20.0 * np.abs(t - 3.0))), axis=1)
    lines = Lines.of(inputs[:, :0], inputs, 0.02)
    np.testing.assert_allclose(lines.tones[0], at, atol=0.005)
    assert [len(tones) for tones in lines.tones[1:]] == [0, 0]
    assert lines.around(Pole(5.0, 0.3), 10).filled == 3.0  # of 0.97 Hz, between 3.5 and 6.5, however they leak
