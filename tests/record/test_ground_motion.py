"""The motion of the ground: its spectrum, its size, its files, and what it cannot be."""

import math
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf
from refusals import refusal
from scipy.signal import welch

from pinn_cli.record.excitation.ground_motion import Envelope, GroundMotion, RecordedMotion
from pinn_cli.settings.instantiation import build

CONF = Path(__file__).parents[2] / "conf" / "excitation" / "ground_motion.yaml"
SPAN = {"ndof": 3, "duration": 40.0, "samples": 4001}
TIME = np.linspace(0.0, 40.0, 4001)


def clough_penzien(f: np.ndarray, fg: float, zg: float, ff: float, zf: float) -> np.ndarray:
    """As the textbook has it, in circular frequencies."""
    w, wg, wf = (2.0 * math.pi * x for x in (f, fg, ff))
    ground = (wg**4 + 4 * zg**2 * wg**2 * w**2) / ((wg**2 - w**2) ** 2 + 4 * zg**2 * wg**2 * w**2)
    return ground * w**4 / ((wf**2 - w**2) ** 2 + 4 * zf**2 * wf**2 * w**2)


def test_the_config_lists_every_setting_and_nothing_else_acts():
    motion = build(OmegaConf.load(CONF), "excitation", **SPAN)
    assert np.max(np.abs(motion.ground(TIME))) == pytest.approx(3.0)
    assert not motion.force(TIME).any()
    assert not motion.forced.any()


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


def test_it_is_known_at_every_time_and_the_seed_tells_it():
    motion = GroundMotion(**SPAN, peak=2.0, seed=5)
    a = motion.ground(TIME)
    assert np.max(np.abs(a)) == pytest.approx(2.0)
    np.testing.assert_allclose(a[1700:1703], motion.ground(TIME[1700:1703]), atol=1e-10)
    np.testing.assert_array_equal(a, GroundMotion(**SPAN, peak=2.0, seed=5).ground(TIME))
    assert not np.allclose(a, GroundMotion(**SPAN, peak=2.0, seed=6).ground(TIME))


def test_a_force_may_act_as_well():
    motion = GroundMotion(**SPAN, force={"band": [0.5, 5.0], "rms": 100.0, "dofs": [3]})
    force = motion.force(TIME)
    assert motion.forced.tolist() == [False, False, True]
    assert np.std(force[:, 2]) == pytest.approx(100.0, rel=0.01)
    assert motion.ground(TIME).any()


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
    scaled = GroundMotion(**SPAN, path=str(files / name), peak=5.0, **settings).ground(TIME)
    assert np.max(np.abs(scaled)) == pytest.approx(5.0)


@pytest.mark.parametrize(("settings", "told"), [({}, True), ({"scale": 9.81}, False), ({"peak": 3.0}, False)])
def test_a_header_that_says_g_is_told(files, caplog, settings, told):
    text = (files / "quake.at2").read_text().replace("M/S2", "G")
    (files / "g.at2").write_text(text)
    GroundMotion(**SPAN, path=str(files / "g.at2"), **settings)
    assert ("g.at2 says that it is in g: excitation.scale=9.80665" in caplog.text) == told


def test_the_ground_is_at_rest_outside_its_motion():
    motion = RecordedMotion(0.1, sinusoids(0.1 * np.arange(401)))
    np.testing.assert_allclose(motion(np.array([-5.0, 41.0, 60.0, 500.0])), 0.0, atol=1e-9)


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
        ("excitation.ground_frequency=0", {"ground_frequency": 0}),
        ("excitation.ground_damping=None", {"ground_damping": None}),
        ("excitation.high_pass=3", {"high_pass": 3}),
        ("excitation.highest=60", {"highest": 60}),
        ("excitation.highest=2.0", {"highest": 2}),
        ("excitation.rise=-1", {"rise": -1}),
        ("excitation.decay=0", {"decay": 0}),
        ("excitation.seed=0.5", {"seed": 0.5}),
        ("excitation.force=5", {"force": 5}),
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
        ("excitation.step=0: must be", "1\n2\n", {"step": 0}),
        ("quake.txt, line 4 reads '0.3, x'", "t, a\n0.1, 1\n0.2, 2\n0.3, x\n", {}),
        ("quake.txt has none", "nothing\nhere\n", {}),
        ("3 values", "0 1\n1 2\n2 3\n", {}),
        ("quake.txt, line 21: 20.5 s after 19 s", "".join(f"{t} 1\n" for t in range(20)) + "20.5 1\n22 2\n", {}),
        ("a motion below 1e+30; it reaches 1e+300", "1e300\n" * 20, {"step": 0.1}),
        ("must be a text file; it is a zip archive or a spreadsheet", "PK\x03\x04", {}),
        ("all of them 0", "0\n" * 20, {"step": 0.1}),
        ("excitation.scale=0", "1\n" * 20, {"step": 0.1, "scale": 0}),
    ],
)
def test_files_that_cannot_be_used(tmp_path, expected, content, settings):
    if content is not None:
        (tmp_path / "quake.txt").write_text(content)
    assert expected in refusal(GroundMotion, **SPAN, path="quake.txt", base=tmp_path, **settings)
