"""Seconds by stage."""

from __future__ import annotations

import time

import pytest

from pinn_cli.runs.stages import Stages


def test_stages_add_up_and_the_total_goes_on() -> None:
    stages = Stages()
    for _ in range(2):
        with stages("record"):
            time.sleep(0.01)
    assert 0.02 <= stages.seconds["record"] <= stages.seconds["total"]
    assert list(stages.seconds) == ["record", "total", "processor"]


def test_a_stage_that_fails_is_timed_too() -> None:
    stages = Stages()
    with pytest.raises(ValueError, match="failed"), stages("estimate"):
        raise ValueError("failed")
    assert "estimate" in stages.seconds


def test_a_run_counts_from_its_beginning() -> None:
    stages = Stages(time.perf_counter() - 5.0)
    stages.reached("table_at")
    seconds = stages.seconds
    assert list(seconds) == ["start_up", "table_at", "total", "processor"]
    assert 5.0 <= seconds["start_up"] <= seconds["table_at"] <= seconds["total"] < 6.0
