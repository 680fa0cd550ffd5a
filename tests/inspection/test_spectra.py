"""Spectra, natural frequencies and damping of a noisy record, and what it says against a structure that was given."""

import numpy as np
import pytest
from scipy.signal import csd, welch

from pinn_cli.inspection.inspection import contradictions, peak_table
from pinn_cli.inspection.modes import ModalRecord
from pinn_cli.inspection.report import spectra_table
from pinn_cli.record.cross_spectra import CrossSpectra, piece_length
from pinn_cli.record.signal import Sampling, Signal, spectra_of
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.structure import Structure

RATE = 50.0


@pytest.fixture(scope="module")
def spectra(chain) -> CrossSpectra[Signal]:
    _, f, u, a = chain.record(120.0, 3)
    sensors = [Signal("roof", a[:, 4], "acceleration", "5"), Signal("laser", u[:, 4], "displacement", "5")]
    force = Signal("hammer", f, "force", "5")
    values = np.stack([s.values for s in (*sensors, force)], axis=1)
    return CrossSpectra.of_pieces(sensors, [force], values - values.mean(axis=0), 1.0 / RATE)


def test_densities_responses_and_coherences_are_those_of_scipy(spectra):
    table = spectra_table(spectra)
    length = piece_length(len(spectra.values))
    options = {"fs": RATE, "window": "hann", "nperseg": length, "noverlap": length // 2, "detrend": "constant"}
    _, _, f = spectra.values.T
    frequency, of_force = welch(f, **options)
    assert table["psd_force_5 [N^2/Hz]"].sum() * frequency[1] == pytest.approx(np.var(f), rel=0.1)
    np.testing.assert_allclose(table["frequency_hz"], frequency[1:])
    for i, (name, unit) in enumerate((("acceleration_5", "(m/s^2)"), ("displacement_5", "m"))):
        power, both = welch(spectra.values[:, i], **options)[1], csd(f, spectra.values[:, i], **options)[1]
        found = table[f"psd_{name} [{unit}^2/Hz]"]
        loud = power[1:] > 1e-4 * power.max()  # SciPy's window is even in another way
        np.testing.assert_allclose(found[loud], power[1:][loud], rtol=0.05)
        real, imag = (table[f"frf_{name}_force_5_{part} [{unit}/N]"] for part in ("real", "imag"))
        resonant = (frequency[1:] > 0.5) & (frequency[1:] < 6.0)
        expected = (both / of_force)[1:][resonant]
        np.testing.assert_allclose((real + 1j * imag)[resonant], expected, atol=0.03 * np.abs(expected).max())
        coherence = np.abs(both[1:]) ** 2 / power[1:] / of_force[1:]
        np.testing.assert_allclose(table[f"coherence_{name}"][resonant], coherence[resonant], atol=0.05)


def test_columns_that_nobody_has_told_go_by_their_names():
    random = np.random.default_rng(0)
    sensors = [
        Signal("x", random.normal(size=512)),
        Signal("left", random.normal(size=512), "velocity", "1"),
        Signal("right", random.normal(size=512), "velocity", "1"),
    ]
    values = np.stack([sensor.values for sensor in sensors], axis=1)
    table = spectra_table(CrossSpectra.of_pieces(sensors, [], values, 0.01))
    assert table.columns.tolist() == ["frequency_hz", "psd_x", "psd_left [(m/s)^2/Hz]", "psd_right [(m/s)^2/Hz]"]


# Of a chain of five equal masses and springs, fixed at one end, Hz.
FREQUENCIES = 0.890 * np.sin(np.pi * np.arange(1, 10, 2) / 22.0) / np.sin(np.pi / 22.0)


def signals(record, **factors: float) -> list[Signal]:
    """The force and three accelerometers, which are so many times what they should be."""
    _, f, _, a = record
    sensors = [Signal(f"a{i}", factors.get(f"a{i}", 1.0) * a[:, i - 1], "acceleration", str(i)) for i in (1, 3, 5)]
    return [Signal("f", f, "force", "5"), *sensors]


def test_two_forces_at_once(chain):
    """Each sensor answers to both; with one of them alone its coherence would be poor."""
    time, f, _, a = chain.record(240.0, 5)
    _, g, _, b = chain.record(240.0, 6)
    every = [Signal("f", f, "force", "5"), Signal("g", g, "force", "1"),
             *(Signal(f"a{i}", a[:, i] + b[:, 4 - i], "acceleration", str(i + 1)) for i in (0, 4))]  # fmt: skip
    spectra = spectra_of(every, Sampling(time))
    within = (spectra.frequency > 1.0) & (spectra.frequency < 6.0)
    assert np.median(spectra.coherence[within]) > 0.95
    alone = spectra_of([every[0], *every[2:]], Sampling(time))
    assert np.median(alone.coherence[within]) < 0.8
    np.testing.assert_allclose([p.frequency for p in ModalRecord.of(every, time).modes][:4], FREQUENCIES[:4], rtol=2e-3)


def test_chance_reaches_the_coherence_that_it_is_said_to():
    random = np.random.default_rng(1)
    noise = [Signal(q[0], random.normal(size=200_000), q, "1") for q in ("force", "acceleration")]
    spectra = spectra_of(noise, Sampling(np.arange(200_000) / 100.0))
    share = np.mean(spectra.coherence > spectra.chance_coherence(0.1))
    assert 0.05 < share < 0.2


def test_peaks_beside_those_of_a_structure(chain):
    record = chain.record(120.0, 0)
    peaks = ModalRecord.of(signals(record), record[0]).modes
    np.testing.assert_allclose([peak.frequency for peak in peaks], FREQUENCIES, rtol=2e-3)
    np.testing.assert_allclose([peak.damping for peak in peaks], 0.02, rtol=0.05)
    assert all(0.5 < peak.explained <= 1.0 for peak in peaks)
    table = peak_table(peaks, 1.02 * FREQUENCIES)
    assert table["mode"].tolist() == [1, 2, 3, 4, 5]
    np.testing.assert_allclose(table["difference_percent"], 2.0, atol=0.2)
    assert peak_table(peaks, None)["structure_hz"].isna().all()
    assert peak_table(peaks, np.array([np.nan, 0.0]))["mode"].isna().all()


def test_a_short_record_of_slow_motion_keeps_its_samples_and_their_step():
    time = np.arange(300) / 100.0
    spectra = spectra_of([Signal("a", np.sin(3.0 * time), "acceleration", "1")], Sampling(time), highest=1.0)
    assert len(spectra.values) == 300
    assert spectra.step == pytest.approx(0.01)


def structure(chain, **changed: list[float]) -> Structure:
    """Springs of the chain, and dampers that have 2 % in the middle of its band."""
    k = chain.K[-1, -1]
    return build_chain(5, Linear(), **({"m": 1.0, "c": 2.0 * 0.02 * k / (2.0 * np.pi * 3.0), "k": k} | changed))


def told(chain, structure: Structure, **factors: float) -> list[str]:
    record = chain.record(60.0, 11)
    return contradictions(structure, signals(record, **factors), Sampling(record[0]))


@pytest.mark.parametrize(("factor", "word"), [(-1.0, "negative"), (1.0 / 9.80665, "1/9.80665")])
def test_a_sensor_away_from_the_force_that_is_turned_or_in_another_unit(chain, factor: float, word: str):
    (text,) = told(chain, structure(chain), a3=factor)
    assert "acceleration of DOF 3" in text
    assert word in text


@pytest.mark.slow
def test_a_mass_that_is_another_one(chain):
    assert told(chain, structure(chain)) == []
    (text,) = told(chain, structure(chain, m=[1.0, 1.0, 1.5, 1.0, 1.0]))
    assert "m_3" in text
    lost = [Signal(name, np.sin(np.arange(500.0)), "acceleration", place) for name, place in (("a", "9"), ("b", ""))]
    assert contradictions(structure(chain), lost, Sampling(np.arange(500) / RATE)) == []  # whose place is no DOF
