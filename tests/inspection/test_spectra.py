"""Spectra as a table: against SciPy's, and with their units."""

import numpy as np
import pytest
from scipy.signal import csd, welch

from pinn_cli.inspection.report import spectra_table
from pinn_cli.record.cross_spectra import CrossSpectra, piece_length
from pinn_cli.record.signal import Signal

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


def test_the_sum_of_a_density_is_the_variance(spectra):
    table = spectra_table(spectra)
    step = table["frequency_hz"][1] - table["frequency_hz"][0]
    assert table["psd_force_5 [N^2/Hz]"].sum() * step == pytest.approx(np.var(spectra.values[:, 2]), rel=0.1)


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
