"""Spoilt records of a random rig, made by a script that lies beside the checkout, through the whole program."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from calls import PinnRun

RIG = Path(__file__).parents[2].parent / "shared" / "tools" / "rig.py"
# Two storeys, velocities on both, 52 dB; the last channel is spoilt.
SEED = "38"
NAMED = {
    "unit": "1/9.80665", "gain": "divide it by", "offset": "offset", "sign": "negative", "swap": "DOFs 1 and 2",
    "delay": "3.00 samples", "clip": "clipped", "mass": "m_2", "zeros": "drops out", "time_unit": "milliseconds",
}  # fmt: skip

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not RIG.is_file(), reason="rig.py is not there")]


@pytest.mark.parametrize("way", NAMED)
def test_a_spoilt_record_is_not_sound_and_its_cause_comes_first(pinn_run: PinnRun, tmp_path: Path, way: str) -> None:
    made = [sys.executable, str(RIG), "make", str(tmp_path / "rig"), "--seed", SEED, "--spoil", way]
    subprocess.run(made, check=True, capture_output=True)
    done = pinn_run("--config-dir", str(tmp_path / "rig"), "experiment=rig", "figures=false", "strict=true")
    assert done.status == 4, done.err
    reason = json.loads((done.directory / "run.json").read_text())["reasons"][0]
    assert NAMED[way] in reason
    if way == "gain":
        assert float(reason.split()[-1]) == pytest.approx(1.15, rel=2e-3), reason
