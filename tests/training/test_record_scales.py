"""Orders of magnitude of a problem."""

from dataclasses import replace

import numpy as np
import pytest
from small_problems import accelerations, measured, small_chain, sped_up

from pinn_cli.scheme.problem import Problem
from pinn_cli.training.record_scales import force_and_velocity_scale

CHAIN = small_chain()
RECORD = measured(CHAIN, snr_db=40.0).record


def test_a_force_that_is_measured_as_zero_is_no_scale():
    silent = accelerations(replace(RECORD, force=np.zeros_like(RECORD.force)))
    assert force_and_velocity_scale(Problem(CHAIN, silent))[0] > 0


def test_a_velocity_goes_with_the_time_scale():
    force, velocity = force_and_velocity_scale(Problem(small_chain(speed=30.0), accelerations(sped_up(RECORD, 30.0))))
    assert (force, velocity) == pytest.approx(
        tuple(np.array(force_and_velocity_scale(Problem(CHAIN, accelerations(RECORD)))) * (1.0, 30.0))
    )
