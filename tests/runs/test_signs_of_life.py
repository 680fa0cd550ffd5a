"""A run that takes long says so."""

from __future__ import annotations

import time

import pytest

from pinn_cli.runs.signs_of_life import signs_of_life
from pinn_cli.runs.stages import Stages


def test_the_stage_and_the_seconds_are_told_less_and_less_often(caplog: pytest.LogCaptureFixture) -> None:
    stages = Stages()
    with signs_of_life(stages, first_s=0.05), stages("record"), stages("imports"):
        time.sleep(0.5)
    told = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert 2 <= len(told) <= 3  # after 0.05, 0.15 and 0.35 s
    assert all(text == "still running after 0 s, now in imports" for text in told)
    time.sleep(0.1)
    assert len([record for record in caplog.records if record.levelname == "WARNING"]) == len(told)


def test_a_short_run_says_nothing(caplog: pytest.LogCaptureFixture) -> None:
    with signs_of_life(Stages()):
        pass
    assert not caplog.records
