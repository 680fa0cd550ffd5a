"""Random structures, made by a script that lies beside the checkout, through the whole program."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

RIG = Path(__file__).parents[1].parent / "shared" / "tools" / "rig.py"
# One to eight storeys; stiffnesses are unknown and prescribed up to a decade off in the second experiment.
SEEDS = ("6", "8")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not RIG.is_file(), reason=f"there is no {RIG.name} beside the checkout"),
]


def tool(*arguments: str) -> str:
    return subprocess.run([sys.executable, str(RIG), *arguments], check=True, capture_output=True, text=True).stdout


@pytest.mark.parametrize("experiment", ["rig", "rig_unknown"])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_random_structure_is_estimated_right_and_called_sound(pinn_run, tmp_path, seed, experiment):
    tool("make", str(tmp_path / "rig"), "--seed", seed)
    done = pinn_run("--config-dir", str(tmp_path / "rig"), f"experiment={experiment}", "figures=false").done()
    score = json.loads(tool("score", str(tmp_path / "rig"), str(done.directory)))
    assert score["verdict"] == "sound"
    assert score["inside_u"] >= 0.7
    assert score["k_error_percent"] < 10.0
    assert score["k_error_std"] < 5.0
