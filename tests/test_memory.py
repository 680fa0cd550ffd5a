"""Freed memory is used again."""

from __future__ import annotations

import subprocess
import sys

import pytest

FAULTS = """
import resource, sys
import numpy as np
from pinn_cli.memory import keep_freed_memory
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
