"""Modes in a band of records whose modes are known."""

import numpy as np
import pytest
from vibrating_records import Wing, wing, wing_record

from pinn_cli.record.record import Record
from pinn_cli.record.spectrum import BandPass
from pinn_cli.scheme.modal_fit import BandSpectra, ModalFit
from pinn_cli.scheme.modal_problem import missing_mode, searched

BAND = (4.0, 12.0)
SIX = (4.4, 5.19, 6.61, 6.88, 9.17, 11.0)


def spectra(values: np.ndarray, band: tuple[float, float] = BAND) -> BandSpectra:
    """Of a record whose first DOF is driven, filtered to its band."""
    sensors, filtered = values.shape[1] - 2, BandPass.of(band, len(values), values[1, 0])
    time = values[filtered.half : len(values) - filtered.half : filtered.factor, 0]
    kept, nothing = filtered.filtered(values[:, 1:]), np.full((len(time), sensors), np.nan)
    force = np.zeros((len(time), sensors))
    force[:, 0] = kept[:, 0]
    record = Record(time, nothing, nothing, kept[:, 1:], force, np.arange(sensors) > 0, band=filtered)
    return BandSpectra.of(record, 0)


def scores(fit: ModalFit, true: Wing) -> np.ndarray:
    """(3, modes in the band), errors of frequency, damping ratio and the largest residue in standard deviations."""
    count, std = len(fit.frequencies), np.sqrt(np.diag(fit.covariance))
    out = []
    for i in np.flatnonzero((true.frequencies > fit.spectra.band[0]) & (true.frequencies < fit.spectra.band[1])):
        j = int(np.abs(fit.frequencies - true.frequencies[i]).argmin())
        s = int(np.abs(true.residues[:, i]).argmax())
        errors = np.log(fit.frequencies[j] / true.frequencies[i]), np.log(fit.ratios[j] / true.ratios[i])
        residue = (fit.residues[s, j] - true.residues[s, i]) / std[2 * count + s * count + j]
        out.append((errors[0] / std[j], errors[1] / std[count + j], residue))
    return np.array(out).T


@pytest.mark.slow
def test_six_modes_two_of_them_four_per_cent_apart() -> None:
    true = wing(3, 2, SIX)
    fit = searched(spectra(wing_record(true, 3, 25.0)))
    own = (true.frequencies > 4) & (true.frequencies < 12)
    np.testing.assert_allclose(fit.frequencies[fit.within], true.frequencies[own], rtol=1e-3)
    np.testing.assert_allclose(fit.ratios[fit.within], true.ratios[own], rtol=0.05)
    np.testing.assert_allclose(fit.residues[0][: len(fit.within)][fit.within], true.residues[0][own], rtol=0.05)
    assert np.abs(scores(fit, true)).max() < 4.0
    assert missing_mode(fit) is None


def test_a_mode_that_is_not_asked_for_is_missing() -> None:
    fit = searched(spectra(wing_record(wing(1, 1, (5.2, 7.3, 9.2)), 1, 15.0)), count=2)
    assert fit.within.sum() == 2
    missed = missing_mode(fit)
    assert missed is not None
    assert min(abs(missed - f) for f in (5.2, 7.3, 9.2)) < 0.1


def test_one_mode_in_a_narrow_band_with_others_beside_it() -> None:
    true = wing(2, 1, (5.19, 6.61, 7.32, 9.17))
    fit = searched(spectra(wing_record(true, 2, 30.0), (7.0, 7.8)), count=1)
    assert fit.frequencies[fit.within] == pytest.approx([7.32], rel=2e-3)
    assert fit.ratios[fit.within] == pytest.approx(true.ratios[3], rel=0.1)


@pytest.mark.slow
def test_intervals_cover() -> None:
    wings = [wing(seed, 2, SIX) for seed in range(12)]
    found = [scores(searched(spectra(wing_record(true, i, 25.0))), true) for i, true in enumerate(wings)]
    covered = (np.abs(np.concatenate(found, axis=1)) < 1.645).mean(axis=1)
    assert (covered > 0.78).all(), covered
