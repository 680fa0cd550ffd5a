"""Freed memory is used again, and is not looked through when the process ends."""

from __future__ import annotations

import subprocess
import sys

import pytest

FAULTS = """
import resource, sys
import numpy as np
from pinn_cli.runs.memory import keep_freed_memory
if sys.argv[1] == "kept":
    keep_freed_memory()
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
(np.ones(2**20) + 1.0).sum()
before = faults()
for _ in range(20):
    (np.ones(2**20) + 1.0).sum()
print(faults() - before)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only glibc is told")
def test_blocks_that_come_and_go_are_not_mapped_anew() -> None:
    kept, given_back = (
        int(subprocess.run([sys.executable, "-c", FAULTS, how], capture_output=True, check=True).stdout)
        for how in ("kept", "given back")
    )
    assert kept < 100
    if given_back < 100:
        pytest.skip("this C library keeps freed memory by itself")


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
