"""Sweeps whose launcher and workers are killed at any moment, and the same command once more."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

import pytest
from calls import SMALL
from interrupted_runs import assert_same_numbers
from sweeps import start

EVERY = "training.checkpoint_every_s=0.1"
ADAM = ("network=mlp", "network.width=16", "training=adam", "training.iterations=150", EVERY)
SWEEP = ("--multirun", *SMALL, *ADAM, "hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "seed=0,1,2")
KILLS = 20


@pytest.mark.slow
def test_a_killed_sweep_ends_with_the_numbers_of_one_that_was_left_alone(tmp_path: Path) -> None:
    began = time.monotonic()
    whole = start(tmp_path, *SWEEP, "hydra.sweep.dir=whole")
    assert whole.communicate(timeout=600) is not None
    lasted = time.monotonic() - began
    moments = random.Random(7)
    for kill in range(KILLS):
        sweep = f"sweep{kill}"
        victim = start(tmp_path, *SWEEP, f"hydra.sweep.dir={sweep}")
        time.sleep(moments.uniform(0.1, 1.0) * lasted)
        os.killpg(victim.pid, signal.SIGKILL)
        victim.communicate()
        again = start(tmp_path, *SWEEP, f"hydra.sweep.dir={sweep}")
        out, err = again.communicate(timeout=600)
        assert again.returncode == 0, err
        assert "3 jobs: 3 finished" in out
        for name in ("fitness.csv", "parameters.csv", "summary.csv"):
            assert (tmp_path / sweep / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), (kill, name)
        for job in ("seed=0", "seed=1", "seed=2"):
            (one,), (other,) = ((tmp_path / place).glob(f"{job}_*") for place in (sweep, "whole"))
            assert_same_numbers(one, other)
