"""Predictions from the force alone: histories between samples, and what channels share."""

from __future__ import annotations

import numpy as np
import pytest
from small_problems import measured, small_chain

from pinn_cli.record.channels import channels
from pinn_cli.verdict.linear_response import decays, felt_modes
from pinn_cli.verdict.prediction import between_samples, predicted


@pytest.fixture(scope="module")
def record():
    return measured(small_chain(ndof=3), snr_db=30.0, duration=8.0, samples=161).record


def test_a_part_of_a_history_is_that_of_the_whole(record) -> None:
    times = np.linspace(record.time[0], record.time[99], 777)
    whole, part = between_samples(record, record.force), between_samples(record, record.force, 100)
    np.testing.assert_allclose(part(times), whole(times), rtol=0.0, atol=1e-12 * np.abs(record.force).max())


def test_unforced_dofs_stay_unforced_and_one_column_is_as_all(record) -> None:
    times = record.time[:-1] + 0.3 * record.step
    force = between_samples(record, record.force)(times)
    assert not force[:, 1:].any()
    np.testing.assert_array_equal(force[:, 0], between_samples(record, record.force[:, 0])(times))


def test_samples_are_met(record) -> None:
    found = between_samples(record, record.force)(record.time)
    np.testing.assert_allclose(found, record.force, atol=1e-9 * np.abs(record.force).max())


def test_channels_that_feel_the_same_modes_share_their_decays(record) -> None:
    prediction = predicted(small_chain("linear", 3), record)
    assert prediction is not None
    one, other = channels(record, ("acceleration",))[:2]
    felt = felt_modes(prediction.modes, one)
    np.testing.assert_array_equal(prediction.decays(one), decays(prediction.modes, felt, record))
    assert prediction.decays(one) is prediction.decays(other)
