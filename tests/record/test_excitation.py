"""Forces and motions of the ground: spectra, sizes, files, and what they cannot be."""

import math
from pathlib import Path

import numpy as np
import pytest
from calls import refusal
from omegaconf import OmegaConf
from scipy.fft import ifft
from scipy.signal import welch

from pinn_cli.record.excitation import banded_noise
from pinn_cli.record.excitation.banded_noise import BandedNoise, sum_of_sinusoids
from pinn_cli.record.excitation.excitation import Excitation
from pinn_cli.record.excitation.ground_motion import Envelope, GroundMotion
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
        ("excitation.dofs", BandedNoise, {**NOISE, "dofs": [4]}),
        ("excitation.dofs", BandedNoise, {**NOISE, "dofs": [1, 1]}),
        ("excitation.dofs", SineSweep, {**SWEEP, "dofs": [1.5]}),
        ("excitation.rms", BandedNoise, {**NOISE, "rms": None}),
        ("excitation.rms", SineSweep, {**SWEEP, "rms": -1.0}),
        ("excitation.seed", BandedNoise, {**NOISE, "seed": -1}),
        ("excitation.phases", BandedNoise, {**NOISE, "phases": "zero"}),
        ("excitation.band", BandedNoise, {**NOISE, "band": [1.0, 0.05]}),
        ("excitation.band", BandedNoise, {**NOISE, "band": [0.05, 34.2]}),
        ("excitation.band", SineSweep, {**SWEEP, "band": [0.0, 1.0], "law": "logarithmic"}),
        ("excitation.law", SineSweep, {**SWEEP, "law": "cubic"}),
        ("excitation.width", Impulse, {**PULSE, "width": 0.05}),
        ("excitation.start", Impulse, {**PULSE, "start": 59.6}),
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
    # Uneven ones, those that do not fill a period, and those that are too far apart for the highest frequency, are not.
    for other in (np.arange(100) ** 1.01, 0.7 * np.arange(100), 2.0 * np.arange(100)):
        expected = np.cos(2.0 * np.pi / 60.0 * np.outer(other, bins)).sum(axis=1, keepdims=True)
        np.testing.assert_allclose(sum_of_sinusoids(other, 60.0, bins, np.ones((len(bins), 1))), expected, atol=1e-9)


SPAN = {"ndof": 3, "duration": 40.0, "samples": 4001}
TIME = np.linspace(0.0, 40.0, 4001)


def clough_penzien(f: np.ndarray, fg: float, zg: float, ff: float, zf: float) -> np.ndarray:
    """As the textbook has it, in circular frequencies."""
    w, wg, wf = (2.0 * math.pi * x for x in (f, fg, ff))
    ground = (wg**4 + 4 * zg**2 * wg**2 * w**2) / ((wg**2 - w**2) ** 2 + 4 * zg**2 * wg**2 * w**2)
    return ground * w**4 / ((wf**2 - w**2) ** 2 + 4 * zf**2 * wf**2 * w**2)


def test_the_config_lists_every_setting_and_no_force_acts_that_nobody_asked_for():
    motion = build(OmegaConf.load(CONF / "ground_motion.yaml"), "excitation", **SPAN)
    assert np.max(np.abs(motion.ground(TIME))) == pytest.approx(3.0)
    assert not motion.force(TIME).any()
    pushed = GroundMotion(**SPAN, force={"band": [0.5, 5.0], "rms": 100.0, "dofs": [3]})
    assert np.std(pushed.force(TIME)[:, 2]) == pytest.approx(100.0, rel=0.01)
    assert (motion.forced.tolist(), pushed.forced.tolist()) == ([False] * 3, [False, False, True])


def test_filtered_noise_has_the_spectrum_of_clough_and_penzien():
    # A long strong phase is stationary: Welch's spectrum of 800 s has 5 % of scatter in bands of 40 bins.
    long = {"ndof": 1, "duration": 800.0, "samples": 32001}
    shape = {"ground_frequency": 2.0, "ground_damping": 0.4, "high_pass": 0.4, "high_pass_damping": 0.5, "highest": 8.0}
    motion = GroundMotion(**long, **shape, rms=1.5, rise=0.0, strong=800.0)
    a = motion.ground(np.linspace(0.0, 800.0, 32001))
    frequency, power = welch(a, 40.0, nperseg=8000)
    assert np.std(a) == pytest.approx(1.5, rel=0.01)
    assert power[frequency > 8.2].max() < 1e-4 * power.max()
    expected = clough_penzien(frequency[1:], 2.0, 0.4, 0.4, 0.5) * (frequency[1:] <= 8.0)
    expected *= 1.5**2 / (expected.sum() * frequency[1])
    bands = [slice(i, i + 40) for i in range(20, 1500, 40)]
    ratio = [power[1:][band].mean() / expected[band].mean() for band in bands]
    np.testing.assert_allclose(ratio, 1.0, atol=0.25)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.03)


def test_the_envelope_rises_stays_and_decays():
    envelope = Envelope(4.0, 15.0, 10.0)
    times = np.array([-1.0, 0.0, 2.0, 4.0, 10.0, 19.0, 29.0, 39.0])
    expected = [0.0, 0.0, 0.25, 1.0, 1.0, 1.0, math.exp(-1), math.exp(-2)]
    np.testing.assert_allclose(envelope(times), expected, rtol=1e-12)
    strong, late = ((TIME > 4) & (TIME < 19), TIME > 30)
    a = GroundMotion(**SPAN, rms=2.0).ground(TIME)
    assert np.std(a[strong]) == pytest.approx(2.0, rel=0.25)
    assert np.std(a[late]) < 0.5
    motion = GroundMotion(**SPAN, rms=2.0)  # known at every time, and its seed tells it
    np.testing.assert_allclose(a[1700:1703], motion.ground(TIME[1700:1703]), atol=1e-10)
    assert not np.allclose(a, GroundMotion(**SPAN, rms=2.0, seed=6).ground(TIME))


def sinusoids(time: np.ndarray) -> np.ndarray:
    """Below 80 % of 5 Hz, under a window that is smooth and has died out at 0 and 40 s."""
    window = np.exp(-((np.asarray(time) - 20.0) ** 2) / 25.0)
    return window * (np.sin(2 * np.pi * 1.3 * time) + 0.5 * np.cos(2 * np.pi * 4.0 * time))


@pytest.fixture
def files(tmp_path) -> Path:
    time = 0.1 * np.arange(401)
    a = sinusoids(time)
    np.savetxt(tmp_path / "two.csv", np.column_stack((time, a)), delimiter=",", header="t (s),a (m/s^2)", fmt="%.10g")
    np.savetxt(tmp_path / "one.txt", a / 9.81, header="g", fmt="%.12g")
    five = np.append(a, np.zeros(4)).reshape(-1, 5)
    head = "PEER NGA STRONG MOTION\nA quake, 5/19/1940, 180\nACCELERATION IN UNITS OF M/S2\nNPTS= 401, DT= .1 SEC\n"
    lines = "\n".join("  ".join(f"{value:.9E}" for value in row) for row in five)
    (tmp_path / "quake.at2").write_text(head + lines + "\n")
    return tmp_path


@pytest.mark.parametrize(
    ("name", "settings"),
    [("two.csv", {}), ("one.txt", {"step": 0.1, "scale": 9.81}), ("quake.at2", {"step": 0.1}), ("quake.at2", {})],
)
def test_a_recorded_motion_is_known_between_its_samples(files, name, settings):
    motion = GroundMotion(**SPAN, path=name, base=files, **settings)
    np.testing.assert_allclose(motion.ground(TIME), sinusoids(TIME), atol=2e-7)
    np.testing.assert_allclose(motion.ground(np.array([-5.0, 41.0, 500.0])), 0.0, atol=1e-8)  # at rest
    scaled = GroundMotion(**SPAN, path=str(files / name), peak=5.0, **settings).ground(TIME)
    assert np.max(np.abs(scaled)) == pytest.approx(5.0)


@pytest.mark.parametrize(("settings", "told"), [({}, True), ({"scale": 9.81}, False), ({"peak": 3.0}, False)])
def test_a_header_that_says_g_is_told(files, caplog, settings, told):
    text = (files / "quake.at2").read_text().replace("M/S2", "G")
    (files / "g.at2").write_text(text)
    GroundMotion(**SPAN, path=str(files / "g.at2"), **settings)
    assert ("g.at2 says that it is in g: excitation.scale=9.80665" in caplog.text) == told


@pytest.mark.parametrize("name", ["el_centro", "kobe", "morgan_hill"])
def test_people_s_records_are_read(shared, name):
    path = shared / "data" / "ground_motion" / f"{name}.csv"
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    motion = GroundMotion(1, 20.0, 4001, path=str(path))
    time = table[table[:, 0] <= 20.0]
    np.testing.assert_allclose(motion.ground(time[:, 0]), time[:, 1], atol=1e-6 * np.abs(table[:, 1]).max())


@pytest.mark.parametrize(
    ("expected", "settings"),
    [
        ("excitation.peak=-1", {"peak": -1}),
        ("excitation.path=5", {"path": 5}),
        ("excitation.rms=1.0", {"rms": 1.0, "peak": 2.0}),
        ("excitation.high_pass=3", {"high_pass": 3}),
        ("excitation.highest=60", {"highest": 60}),
        ("excitation.highest=2.0", {"highest": 2}),
        ("excitation.seed=0.5", {"seed": 0.5}),
        ("excitation.force={'band': [0, 1]}", {"force": {"band": [0, 1]}}),
    ],
)
def test_settings_that_cannot_be_used(expected, settings):
    assert refusal(GroundMotion, **SPAN, **settings).startswith(expected)


@pytest.mark.parametrize(
    ("expected", "content", "settings"),
    [
        ("excitation.path=", None, {}),
        ("excitation.step=None", "1\n2\n3\n", {}),
        ("excitation.step=0.1", "0,1\n1,2\n2,3\n", {"step": 0.1}),
        ("quake.txt, line 4 reads '0.3, x'", "t, a\n0.1, 1\n0.2, 2\n0.3, x\n", {}),
        ("quake.txt has none", "nothing\nhere\n", {}),
        ("quake.txt, line 21: 20.5 s after 19 s", "".join(f"{t} 1\n" for t in range(20)) + "20.5 1\n22 2\n", {}),
        ("to 1e+30; 20 values, the largest of them 1e+300", "1e300\n" * 20, {"step": 0.1}),
        ("the largest of them 0", "0\n" * 20, {"step": 0.1}),
        ("excitation.scale=0", "1\n" * 20, {"step": 0.1, "scale": 0}),
    ],
)
def test_files_that_cannot_be_used(tmp_path, expected, content, settings):
    if content is not None:
        (tmp_path / "quake.txt").write_text(content)
    assert expected in refusal(GroundMotion, **SPAN, path="quake.txt", base=tmp_path, **settings)
