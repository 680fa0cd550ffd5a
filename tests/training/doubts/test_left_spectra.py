"""What is left of a record, band by band: a column is as certain as the band in which it is least disturbed."""

import numpy as np
import pytest

from pinn_cli.training.doubts.left_spectra import LeftSpectra, banded_gram, bands_of

STEP, COUNT = 0.01, 2000


def spectra(value: float, seed: int = 0) -> LeftSpectra:
    """Of noise that grows with the square of the frequency, less a slow column, and of another one beside it."""
    rng, edges = np.random.default_rng(seed), bands_of(COUNT * STEP, 40.0, 16)
    noise = np.gradient(np.gradient(rng.standard_normal(COUNT)))
    slow = np.cumsum(rng.standard_normal((COUNT, 2)), axis=0) / 30.0
    gram = banded_gram(np.column_stack((noise - value * slow[:, 0], slow)), STEP, edges)
    freedom = 2.0 * COUNT * STEP * np.diff(edges)
    return LeftSpectra(gram, freedom, np.eye(2), np.zeros(2), np.ones(len(freedom), bool))


@pytest.mark.parametrize("seed", range(3))
def test_a_slow_column_is_found_below_fast_noise(seed: int):
    """All of the noise together is some hundred times as large as what the column leaves at low frequencies."""
    found = spectra(0.05, seed)
    before = found.fit([], found.energy)
    fit, other = found.fit([0], found.energy), found.fit([1], found.energy)
    std = fit.information[0] ** -0.5
    assert abs(fit.step[0] - 0.05) < 4.0 * std < 0.03
    assert before.minus_log - fit.minus_log > 15.0
    assert before.minus_log - fit.minus_log > 3.0 * (before.minus_log - other.minus_log)


@pytest.mark.parametrize("seed", range(5))
def test_a_column_that_is_not_there_gains_nothing(seed: int):
    found = spectra(0.0, seed)
    gain = found.fit([], found.energy).minus_log - found.fit([0], found.energy).minus_log
    assert -0.1 < gain < 5.0


def test_means_count_nowhere():
    rng = np.random.default_rng(0)
    histories, edges = rng.standard_normal((200, 3)), bands_of(2.0, 40.0, 16)
    assert banded_gram(histories + 7.0, STEP, edges) == pytest.approx(banded_gram(histories, STEP, edges), abs=1e-9)
