import math
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf
from refusals import refusal
from scipy.fft import ifft

from pinn_cli.record.excitation import banded_noise
from pinn_cli.record.excitation.banded_noise import BandedNoise, sum_of_sinusoids
from pinn_cli.record.excitation.excitation import Excitation
from pinn_cli.record.excitation.impulse import Impulse
from pinn_cli.record.excitation.sine_sweep import SineSweep
from pinn_cli.settings.instantiation import build

CONF = Path(__file__).parents[2] / "conf" / "excitation"
RECORD = {"ndof": 3, "duration": 60.0, "samples": 4096}
NOISE = {**RECORD, "band": [0.05, 1.0], "rms": 1.0, "dofs": [1]}
SWEEP = {**RECORD, "band": [0.1, 2.0], "rms": 1.5, "dofs": [2]}
PULSE = {**RECORD, "peak": 10.0, "width": 0.5, "dofs": [1]}


def sampled(excitation: Excitation) -> tuple[np.ndarray, np.ndarray]:
    time = np.linspace(0.0, excitation.duration, excitation.samples)
    return time, excitation.force(time)


@pytest.mark.parametrize("phases", ["random", "authors"])
def test_banded_noise_is_the_same_at_few_times_as_at_many(phases):
    noise = BandedNoise(**{**NOISE, "dofs": [1, 3]}, phases=phases)
    time = np.linspace(-3.0, 70.0, 1777)
    together = noise.force(time)
    np.testing.assert_allclose(
        together, np.concatenate([noise.force(time[i : i + 1]) for i in range(1777)]), atol=1e-11
    )
    assert not together[:, 1].any()


@pytest.mark.parametrize("phases", ["random", "authors"])
def test_banded_noise_between_samples_is_the_band_limited_interpolation(phases):
    # Zero-padding the spectrum of one period interpolates a band-limited periodic signal exactly.
    noise = BandedNoise(**{**NOISE, "samples": 512}, phases=phases)
    coarse = noise.force(np.arange(512) * noise.period / 512)[:, 0]
    padded = np.fft.irfft(np.fft.rfft(coarse), n=4 * 512) * 4
    fine = noise.force(np.arange(4 * 512) * noise.period / (4 * 512))[:, 0]
    np.testing.assert_allclose(fine, padded, atol=1e-11)


def test_banded_noise_has_its_rms_and_its_band():
    noise = BandedNoise(**{**NOISE, "rms": 0.3, "band": [0.5, 2.0]})
    force = noise.force(np.arange(4096) * noise.period / 4096)[:, 0]
    assert np.sqrt(np.mean(force**2)) == pytest.approx(0.3, rel=1e-12)
    frequency = np.fft.rfftfreq(4096, noise.period / 4096)
    power = np.abs(np.fft.rfft(force))
    inside = (frequency > 0.5 - 1e-9) & (frequency < 2.0 + 1e-9)
    assert power[~inside].max() < 1e-9 * power[inside].min()


def test_banded_noise_phases_are_seeded_and_differ_between_dofs():
    both = BandedNoise(**{**NOISE, "dofs": [1, 3]}, seed=5)
    time, force = sampled(both)
    assert abs(np.corrcoef(force[:, 0], force[:, 2])[0, 1]) < 0.5
    np.testing.assert_allclose(BandedNoise(**{**NOISE, "dofs": [3]}, seed=5).force(time)[:, 2], force[:, 2])
    assert not np.allclose(BandedNoise(**{**NOISE, "dofs": [3]}, seed=6).force(time)[:, 2], force[:, 2])
    assert both.forced.tolist() == [True, False, True]


@pytest.mark.parametrize("law", ["linear", "logarithmic"])
def test_sweep_has_its_frequency_at_every_time_and_its_rms(law):
    sweep = SineSweep(**SWEEP, law=law)
    time, force = sampled(sweep)
    cycles = sweep._cycles(time)
    share = time / 60.0
    expected = 0.1 + 1.9 * share if law == "linear" else 0.1 * 20.0**share
    np.testing.assert_allclose(np.gradient(cycles, time)[1:-1], expected[1:-1], rtol=1e-4)
    assert np.sqrt(np.mean(force[:, 1] ** 2)) == pytest.approx(1.5, rel=0.03)
    assert not force[:, [0, 2]].any()


def test_impulse_is_a_half_sine():
    pulse = Impulse(**PULSE, start=2.0)
    force = pulse.force(np.array([0.0, 2.0, 2.125, 2.25, 2.5, 2.51, 60.0]))[:, 0]
    np.testing.assert_allclose(force, [0, 0, 10 * math.sin(math.pi / 4), 10, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("setting", "excitation", "settings"),
    [
        ("excitation.dofs", BandedNoise, {**NOISE, "dofs": []}),
        ("excitation.dofs", BandedNoise, {**NOISE, "dofs": [0]}),
        ("excitation.dofs", BandedNoise, {**NOISE, "dofs": [4]}),
        ("excitation.dofs", BandedNoise, {**NOISE, "dofs": [1, 1]}),
        ("excitation.dofs", BandedNoise, {**NOISE, "dofs": 1}),
        ("excitation.dofs", SineSweep, {**SWEEP, "dofs": [1.5]}),
        ("excitation.rms", BandedNoise, {**NOISE, "rms": 0.0}),
        ("excitation.rms", BandedNoise, {**NOISE, "rms": math.nan}),
        ("excitation.rms", BandedNoise, {**NOISE, "rms": None}),
        ("excitation.rms", SineSweep, {**SWEEP, "rms": -1.0}),
        ("excitation.seed", BandedNoise, {**NOISE, "seed": -1}),
        ("excitation.phases", BandedNoise, {**NOISE, "phases": "zero"}),
        ("excitation.band", BandedNoise, {**NOISE, "band": [1.0, 0.05]}),
        ("excitation.band", BandedNoise, {**NOISE, "band": [0.05]}),
        ("excitation.band", BandedNoise, {**NOISE, "band": [0.05, math.inf]}),
        ("excitation.band", BandedNoise, {**NOISE, "band": [0.05, 34.2]}),
        ("excitation.band", SineSweep, {**SWEEP, "band": [0.05, 34.2]}),
        ("excitation.band", SineSweep, {**SWEEP, "band": [0.0, 1.0], "law": "logarithmic"}),
        ("excitation.law", SineSweep, {**SWEEP, "law": "cubic"}),
        ("excitation.peak", Impulse, {**PULSE, "peak": math.nan}),
        ("excitation.width", Impulse, {**PULSE, "width": 0.0}),
        ("excitation.width", Impulse, {**PULSE, "width": 0.05}),
        ("excitation.start", Impulse, {**PULSE, "start": -1.0}),
        ("excitation.start", Impulse, {**PULSE, "start": 59.6}),
        ("simulation.duration", BandedNoise, {**NOISE, "duration": 0.0}),
        ("simulation.samples", Impulse, {**PULSE, "samples": 15}),
    ],
)
def test_illegal_settings_are_named(setting, excitation, settings):
    assert refusal(excitation, **settings).startswith(f"{setting}=")


@pytest.mark.parametrize("name", ["banded_noise", "sine_sweep", "impulse"])
def test_every_config_is_an_excitation(name):
    excitation = build(OmegaConf.load(CONF / f"{name}.yaml"), "excitation", ndof=6, duration=60.0, samples=4096)
    _, force = sampled(excitation)
    assert force.shape == (4096, 6)
    assert force[:, 0].any()
    assert not force[:, 1:].any()


@pytest.mark.parametrize(("begin", "samples"), [(0.0, 241), (0.125, 240), (0.3, 700)])
def test_many_evenly_spaced_times_are_transformed(begin, samples, monkeypatch):
    rng, bins = np.random.default_rng(0), np.arange(3, 40)
    coefficients = rng.normal(size=(len(bins), 2)) + 1j * rng.normal(size=(len(bins), 2))
    time = begin + 0.25 * np.arange(samples)
    expected = sum_of_sinusoids(time, 60.0, bins, coefficients)
    transformed = []
    monkeypatch.setattr(banded_noise, "MANY_TERMS", 1)
    monkeypatch.setattr(banded_noise, "ifft", lambda *x, **settings: transformed.append(1) or ifft(*x, **settings))
    np.testing.assert_allclose(sum_of_sinusoids(time, 60.0, bins, coefficients), expected, atol=1e-11)
    assert transformed


@pytest.mark.parametrize("time", [np.arange(100) ** 1.01, 0.7 * np.arange(100), 2.0 * np.arange(100)])
def test_other_times_are_not(time, monkeypatch):
    """Uneven ones, those that do not fill a period, and those that are too far apart for the highest frequency."""
    bins, coefficients = np.arange(3, 40), np.ones((37, 1))
    expected = np.cos(2.0 * np.pi / 60.0 * np.outer(time, bins)).sum(axis=1, keepdims=True)
    monkeypatch.setattr(banded_noise, "MANY_TERMS", 1)
    np.testing.assert_allclose(sum_of_sinusoids(time, 60.0, bins, coefficients), expected, atol=1e-9)
