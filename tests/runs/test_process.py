"""Objects that stay are not looked through for garbage."""

from __future__ import annotations

import subprocess
import sys

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
