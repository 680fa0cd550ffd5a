"""Seconds by stage, and what a run that takes long says of itself."""

from __future__ import annotations

import time

import pytest

from pinn_cli.runs.stages import Stages, signs_of_life


def test_stages_add_up_and_the_total_goes_on() -> None:
    stages = Stages()
    for _ in range(2):
        with stages("record"):
            time.sleep(0.01)
    assert 0.02 <= stages.seconds["record"] <= stages.seconds["total"]
    assert list(stages.seconds) == ["record", "total", "processor"]


def test_a_run_counts_from_its_beginning() -> None:
    stages = Stages(time.perf_counter() - 5.0)
    stages.reached("table_at")
    seconds = stages.seconds
    assert list(seconds) == ["start_up", "table_at", "total", "processor"]
    assert 5.0 <= seconds["start_up"] <= seconds["table_at"] <= seconds["total"] < 6.0


def test_the_stage_and_the_seconds_are_told_less_and_less_often(caplog: pytest.LogCaptureFixture) -> None:
    stages = Stages()
    with signs_of_life(stages, first_s=0.05), stages("record"), stages("imports"):
        time.sleep(0.5)
    told = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert 2 <= len(told) <= 3  # after 0.05, 0.15 and 0.35 s
    assert all(text == "still running after 0 s, now in imports" for text in told)
    time.sleep(0.1)
    assert len([record for record in caplog.records if record.levelname == "WARNING"]) == len(told)
