"""Predictions from the force alone: what is left of a channel once free decays are out, and what channels share."""

from dataclasses import replace

import numpy as np
import pytest
from frame_records import measure
from small_problems import measured, small_chain

from pinn_cli.record.channels import channels
from pinn_cli.record.free_run import free_run
from pinn_cli.verdict.prediction import predicted


@pytest.fixture(scope="module")
def record():
    return measured(small_chain(ndof=3), snr_db=30.0, duration=8.0, samples=161).record


def left_over(prediction, channel):
    """Of the channel, once the response and free decays are taken out, relative."""
    basis = prediction.decays(channel)
    residual = channel.measured - channel.of(prediction.response)
    residual = residual - basis @ (basis.T @ residual)
    return np.linalg.norm(residual) / np.linalg.norm(channel.measured)


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
@pytest.mark.parametrize("start", [None, ([0.1, 0.2, -0.1], [0.0, 0.3, 0.0])], ids=["rest", "elsewhere"])
def test_the_response_is_that_of_a_simulation_up_to_free_decays(frame, quantity, start):
    record = measure(frame, None, quantity=quantity)
    prediction = predicted(frame, record, start)
    assert all(left_over(prediction, channel) < 1e-5 for channel in channels(record))


def test_a_held_force(frame):
    record = replace(measure(frame, None), intersample="zero_order_hold")
    record = replace(record, acceleration=free_run(frame, record).acceleration)
    assert all(left_over(predicted(frame, record), c) < 1e-9 for c in channels(record))


def test_a_structure_whose_free_motion_grows_has_no_prediction(frame):
    growing = frame.with_parameters(c=-0.1 * frame.parameters["c"])
    assert predicted(growing, measure(frame, None)) is None
