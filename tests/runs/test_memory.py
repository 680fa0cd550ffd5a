"""Objects that stay are not looked through for garbage, neither meanwhile nor when the process ends."""

from __future__ import annotations

import subprocess
import sys

import pytest

ENDING = """
import atexit, gc, sys
from pinn_cli.runs.memory import leave_without_collecting
atexit.register(lambda: print(gc.get_freeze_count() > 0))  # called after those that are registered later
if sys.argv[1] == "left":
    leave_without_collecting()
    leave_without_collecting()
"""


@pytest.mark.parametrize("how", ["left", "collected"])
def test_the_last_collections_find_nothing(how: str) -> None:
    said = subprocess.run([sys.executable, "-c", ENDING, how], capture_output=True, check=True, text=True).stdout
    assert said.strip() == str(how == "left")


IMPORTING = """
import gc
from pinn_cli.runs.memory import collect_rarely, keep_imported
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
