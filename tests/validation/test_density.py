"""The score of a predicted channel: what it is for predictions whose quality is known."""

import numpy as np
import pytest
from small_problems import measured as measured_record
from small_problems import small_chain

from pinn_cli.record.channels import channels
from pinn_cli.validation.validation import channel_noise, compared

NOISE, SAMPLES = 0.1, 200_000


@pytest.fixture
def response() -> np.ndarray:
    return np.random.default_rng(0).normal(size=SAMPLES)


@pytest.fixture
def measured(response: np.ndarray) -> np.ndarray:
    return response + NOISE * np.random.default_rng(1).normal(size=SAMPLES)


def test_the_true_response_scores_nothing(response: np.ndarray, measured: np.ndarray) -> None:
    agreement = compared(measured, response, np.zeros(SAMPLES), NOISE)
    assert agreement["score"] == pytest.approx(0.0, abs=0.01)
    assert agreement["standardised_error_rms"] == pytest.approx(1.0, abs=0.01)
    assert agreement["coverage_95_percent"] == pytest.approx(95.0, abs=0.5)


def test_the_right_spread_scores_best(response: np.ndarray, measured: np.ndarray) -> None:
    predicted = response + 0.3 * np.random.default_rng(2).normal(size=SAMPLES)
    spreads = [0.05, 0.15, 0.3, 0.6, 1.2]
    scores = [compared(measured, predicted, np.full(SAMPLES, spread), NOISE)["score"] for spread in spreads]
    assert spreads[int(np.argmin(scores))] == 0.3
    # Of a normal distribution: half the logarithm of the variances' ratio.
    assert min(scores) == pytest.approx(0.5 * np.log(0.1 / 0.01), rel=0.01)


def test_without_a_spread_it_is_the_logarithm_of_the_error(response: np.ndarray, measured: np.ndarray) -> None:
    predicted = response + 0.3 * np.random.default_rng(2).normal(size=SAMPLES)
    agreement = compared(measured, predicted, np.full(SAMPLES, np.nan), NOISE)
    assert agreement["score"] == pytest.approx(np.log(agreement["error_rms"] / NOISE))
    assert np.isnan(agreement["coverage_95_percent"])


def test_no_prediction_has_no_score(measured: np.ndarray) -> None:
    assert np.isnan(compared(measured, np.full(SAMPLES, np.nan), np.zeros(SAMPLES), NOISE)["score"])


def channel(record, dof):
    return next(c for c in channels(record, ["acceleration"]) if c.dof == dof)


def test_the_noise_is_that_of_the_channel() -> None:
    structure = small_chain()
    noisy, clean = (measured_record(structure, snr_db=snr).record for snr in (20.0, None))
    for dof in np.flatnonzero(noisy.sensors("acceleration")):
        true = float(np.std(noisy.acceleration[:, dof] - clean.acceleration[:, dof]))
        assert channel_noise(noisy, channel(noisy, dof)) == pytest.approx(true, rel=0.3)
        rms = float(np.sqrt(np.mean(clean.acceleration[:, dof] ** 2)))
        assert 1e-6 * rms <= channel_noise(clean, channel(clean, dof)) < 0.01 * rms
