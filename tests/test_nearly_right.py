"""The judge of models that are nearly right: without an error the peer finds the truth, with one the truth misses."""

import re

import numpy as np
import pandas as pd
import pytest

from benchmarks.nearly_right.__main__ import overlap_percent, rows
from benchmarks.nearly_right.machines import KINDS, machine, measured
from benchmarks.nearly_right.output_error import fitted, missed_percent


@pytest.mark.parametrize("number", [1, 4])
def test_a_record_of_the_model_itself_is_fitted_to_the_truth(number: int) -> None:
    truth = measured("none", 0, number)
    half, dt = truth.half, 1.0 / truth.machine.rate
    periods = round(4.0 / truth.machine.frequencies[0] / dt)
    found, _ = fitted(truth.model, truth.guess, truth.force[:half], truth.sensors[:half], dt, periods)
    assert found == pytest.approx(truth.true, rel=0.02)  # the load cell's noise moves dampers by a per cent
    unseen = truth.force[half:], truth.sensors[half:]
    assert missed_percent(truth.model, found, *unseen, dt) < 0.02  # sensors of 40 dB: 0.01


def test_the_peer_s_friction_steps_like_its_linear_chain_without_friction() -> None:
    there = machine(4)
    force = np.sin(np.arange(400) * 0.3) * 100.0
    rubbing = type(there.model)(2, 2, there.sensors, speed=0.1)
    p, still = there.linear[None], np.zeros((1, 4))
    stepped = rubbing.states(np.append(p, [[0.0, 0.0]], axis=1), still, force, 1.0 / there.rate)
    exact = there.model.states(p, still, force, 1.0 / there.rate)
    assert stepped == pytest.approx(exact, abs=2e-3 * np.abs(exact).max())


def test_intervals_overlap_pair_by_pair_and_a_missing_one_counts_nothing() -> None:
    lower, upper = [0.0, 0.5, 3.0, np.nan], [1.0, 2.0, 4.0, np.nan]
    masses = pd.DataFrame({"parameter": "m_1", "lower_90": lower, "upper_90": upper})
    friction = pd.DataFrame({"parameter": "F_c_1", "lower_90": lower, "upper_90": lower})
    assert overlap_percent(pd.concat([masses, friction])) == pytest.approx(100.0 / 3.0)


@pytest.mark.slow
def test_without_an_error_the_program_is_sound_and_runs_as_freely_as_the_fit() -> None:
    found = rows("none", 0, [])
    assert set(found["verdict"]) == {"sound"}
    assert found["missed"][0] < 1.1 * found["fit_missed"][0] + 1e-3
    assert found["estimate"].to_numpy() == pytest.approx(found["true"].to_numpy(), rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["stick_slip", "second_mode", "sliding_mass", "lagging_load_cell"])
def test_what_is_missing_is_what_is_named_first(kind: str) -> None:
    found = rows(kind, 1, [])
    assert set(found["verdict"]) == {"questionable"}
    assert re.search(KINDS[kind].names, found["reasons"][0].partition(" | ")[0], re.IGNORECASE)
