"""Predictions from the force alone: what channels share."""

from __future__ import annotations

import numpy as np
import pytest
from small_problems import measured, small_chain

from pinn_cli.record.channels import channels
from pinn_cli.verdict.linear_response import decays, felt_modes
from pinn_cli.verdict.prediction import predicted


@pytest.fixture(scope="module")
def record():
    return measured(small_chain(ndof=3), snr_db=30.0, duration=8.0, samples=161).record


def test_channels_that_feel_the_same_modes_share_their_decays(record) -> None:
    prediction = predicted(small_chain("linear", 3), record)
    assert prediction is not None
    one, other = channels(record, ("acceleration",))[:2]
    felt = felt_modes(prediction.modes, one)
    np.testing.assert_array_equal(prediction.decays(one), decays(prediction.modes, felt, record))
    assert prediction.decays(one) is prediction.decays(other)
