"""The response in the frequency domain against time integration, and what free decays span."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from frame_records import measure

from pinn_cli.record.channels import channels
from pinn_cli.record.resimulation import resimulate
from pinn_cli.system.modes import Modes
from pinn_cli.verdict.linear_response import decays, felt_modes, linear_response


def left_over(modes, channel, record, response):
    """Of the channel, once the response and free decays are taken out, relative."""
    basis = decays(modes, felt_modes(modes, channel), record)
    residual = channel.measured - channel.of(response)
    residual = residual - basis @ (basis.T @ residual)
    return np.linalg.norm(residual) / np.linalg.norm(channel.measured)


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
def test_the_response_is_that_of_a_simulation_up_to_free_decays(frame, quantity):
    record = measure(frame, None, quantity=quantity)
    modes = Modes.of(frame)
    response = linear_response(modes, record)
    assert all(left_over(modes, channel, record, response) < 3e-3 for channel in channels(record))


def test_a_held_force(frame):
    record = replace(measure(frame, None), intersample="zero_order_hold")
    held = resimulate(frame, record, (np.zeros(3), np.zeros(3)))
    record = replace(record, acceleration=held.acceleration)
    modes = Modes.of(frame)
    assert all(left_over(modes, c, record, linear_response(modes, record)) < 2e-2 for c in channels(record))


def test_natural_frequencies(frame):
    modes = Modes.of(frame)
    exact = 2 * np.sqrt(1.5) * np.sin(np.pi * np.array([1, 3, 5]) / 14) / (2 * np.pi)
    assert modes.natural_frequencies == pytest.approx(exact)
    assert modes.stable
