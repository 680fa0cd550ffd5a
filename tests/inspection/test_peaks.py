"""Natural frequencies and damping of a chain whose equations are written out here, from its noisy record."""

import numpy as np
import pytest

from pinn_cli.inspection.inspection import peak_table
from pinn_cli.inspection.modes import ModalRecord
from pinn_cli.record.identification.lines import RecordMode
from pinn_cli.record.signal import Sampling, Signal, spectra_of

# Of a chain of five equal masses and springs, fixed at one end, Hz.
FREQUENCIES = 0.890 * np.sin(np.pi * np.arange(1, 10, 2) / 22.0) / np.sin(np.pi / 22.0)


def signals(record) -> list[Signal]:
    _, f, _, a = record
    sensors = [Signal(f"a{i + 1}", a[:, i], "acceleration", str(i + 1)) for i in (0, 2, 4)]
    return [Signal("f", f, "force", "5"), *sensors]


def found_in(columns: list[Signal], time: np.ndarray) -> list[RecordMode]:
    return list(ModalRecord.of(columns, time).modes)


def test_intervals_hold_the_true_modes(chain):
    """Of some 50 modes of ten records: 90 % intervals, which hold 75 % or more."""
    inside = []
    for seed in range(10):
        record = chain.record(90.0, 100 + seed, snr_db=20.0)
        for peak in found_in(signals(record), record[0]):
            true = FREQUENCIES[np.argmin(np.abs(FREQUENCIES - peak.frequency))]
            inside.append(abs(peak.frequency - true) < 1.645 * peak.frequency_std)
            inside.append(abs(peak.damping - 0.02) < 1.645 * peak.damping_std)
    assert len(inside) >= 90
    assert 0.8 <= np.mean(inside) <= 0.97


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
    np.testing.assert_allclose([p.frequency for p in found_in(every, time)][:4], FREQUENCIES[:4], rtol=2e-3)


def test_chance_reaches_the_coherence_that_it_is_said_to():
    random = np.random.default_rng(1)
    noise = [Signal(q[0], random.normal(size=200_000), q, "1") for q in ("force", "acceleration")]
    spectra = spectra_of(noise, Sampling(np.arange(200_000) / 100.0))
    share = np.mean(spectra.coherence > spectra.chance_coherence(0.1))
    assert 0.05 < share < 0.2


def test_peaks_beside_those_of_a_structure(chain):
    record = chain.record(120.0, 0)
    peaks = found_in(signals(record), record[0])
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
