"""Seconds by stage, what a run that takes long says of itself, and that imported objects are no garbage."""

import subprocess
import sys
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


IMPORTING = """
import gc
from pinn_cli.runs.process import collect_rarely, keep_imported
usual = gc.get_threshold()
collect_rarely()
rarely = gc.get_threshold()
kept = [[] for _ in range(1000)]
keep_imported()
print(rarely[0] > 10 * usual[0], gc.get_threshold() == usual, gc.get_freeze_count() >= 1000)
before = gc.get_freeze_count()
more = [[] for _ in range(1000)]
collect_rarely()
keep_imported()
print(gc.get_threshold() == usual, gc.get_freeze_count() == before)
"""


def test_imported_objects_are_not_looked_through_and_later_ones_are() -> None:
    said = subprocess.run([sys.executable, "-c", IMPORTING], capture_output=True, check=True, text=True).stdout
    assert said.split() == ["True"] * 5
