"""What resonances leak into the lines of short records, on average over many of them."""

from dataclasses import replace

import numpy as np
import pytest
from ambient_records import ambient_record

from pinn_cli.record.cross_spectra import taper
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.training.whittle.spectral_model import ExpectedSpectra, Leakage, SpectralModel, spectra_in_band
from pinn_cli.training.whittle.whittle_estimate import Whittle

SAMPLES, RESONANCE, DAMPING = 2000, 0.02, 0.005
RATE, DURATION, EDGE, RECORDS = 100.0, 20.0, 40.0, 24


def resonance(frequency):
    ratio = np.maximum(frequency, 1e-6) / RESONANCE
    return 1.0 / ((1.0 - ratio**2) ** 2 + (2.0 * DAMPING * ratio) ** 2)


def test_a_line_is_a_mean_over_its_neighbours():
    window, stop, long = taper(SAMPLES, 0.1), 200, 2**17
    found = Leakage(window, stop)(resonance(np.arange(801) / (2.0 * SAMPLES))[:, None, None])[:, 0, 0].real
    random, power, count = np.random.default_rng(0), np.zeros(stop), 0
    for _ in range(6):
        white = np.fft.rfft(random.standard_normal(long))
        history = np.fft.irfft(white * np.sqrt(resonance(np.fft.rfftfreq(long))), long)
        for part in history[: long // SAMPLES * SAMPLES].reshape(-1, SAMPLES):
            power += np.abs(np.fft.rfft(part * window)[:stop]) ** 2 / np.sum(window**2)
            count += 1
    power /= count
    for lines in (slice(25, 35), slice(36, 40), slice(41, 45), slice(46, 56), slice(60, 90)):
        assert found[lines].sum() == pytest.approx(power[lines].sum(), rel=0.25)
    assert found[46:56].sum() > 1.5 * resonance(np.arange(46, 56) / SAMPLES).sum()  # it matters here


@pytest.mark.parametrize(
    "measured",
    [pytest.param((), id="no force measured"), pytest.param((0,), id="one of two", marks=pytest.mark.slow)],
)
def test_spectra_are_as_expected_on_average(measured):
    parts = ((1.0, 1.7), (2.3, 4.0), (4.0, 6.0), (6.0, 10.0), (10.0, 30.0))
    sums = np.zeros((3, len(parts), 2))
    for seed in range(RECORDS):
        made = ambient_record(2.0, RATE, DURATION, EDGE, floors=2, sensors=(0, 1), seed=seed, snr_db=60.0)
        force = np.full_like(made.record.force, np.nan)
        force[:, measured] = made.truth.force[:, measured]
        problem = SparseRecovery(parameter_uncertainty=0.1).pose(made.structure, [replace(made.record, force=force)])
        model = SpectralModel(problem.alone, spectra_in_band(problem.alone.record))
        model.load_noise[:] = 0.0
        x = np.zeros(model.size)
        x[model.places["shape"]] = 0.5 * np.log(100.0**2 * RATE / 2.0 / EDGE)
        x[model.places["noise"]] = np.log(made.noise)
        plain, seen = model.power(x)
        left, _ = Whittle(model, True)._residual_spectra(seen)
        for which, power in enumerate((left, ExpectedSpectra(model)(model, x), plain)):
            for part, (low, high) in enumerate(parts):
                own = (model.spectrum.frequency >= low) & (model.spectrum.frequency < high)
                sums[which, part] += np.einsum("gss->gs", power[own]).real.sum(0)
    seen_power, mean, without = sums
    np.testing.assert_allclose(mean, seen_power, rtol=0.13)
    assert np.max(np.abs(without / seen_power - 1.0)) > 0.15  # lines beside the first resonance
