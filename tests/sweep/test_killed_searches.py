"""Searches in processes of their own, killed at any moment, and the same command once more; two trials at a time."""

import os
import random
import signal
import time
from pathlib import Path

import pandas as pd
import pytest
from calls import SMALL
from sweeps import mlflow_runs, start

pytest.importorskip("optuna", reason="the extra optuna is not installed")
pytest.importorskip("mlflow", reason="the extra mlflow is not installed")

TRIALS, KILLS = 6, 5
SEARCH = (
    "--multirun", "hydra/sweeper=search", "validation=heldout", *SMALL, "scheme.unobserved_fraction=0.3",
    "network.knots_per_period=interval(1.0,5.0)", "network.degree=choice(3,4,6)", "hydra.sweeper.sampler.startup=3",
    f"hydra.sweeper.n_trials={TRIALS}", "tracking=mlflow", "tracking.files=false",
)  # fmt: skip


def trials(sweep: Path) -> pd.DataFrame:
    return pd.read_csv(sweep / "search.csv").drop(columns="seconds")


def carried_out(folder: Path, *overrides: str) -> str:
    search = start(folder, *SEARCH, *overrides)
    out, err = search.communicate(timeout=600)
    assert search.returncode == 0, err
    return out


@pytest.mark.slow
def test_a_killed_search_ends_with_the_trials_of_one_that_was_left_alone(tmp_path: Path) -> None:
    began = time.monotonic()
    best = carried_out(tmp_path, "hydra.sweep.dir=whole", "tracking.uri=sqlite:///whole.db").splitlines()[:2]
    lasted = time.monotonic() - began
    whole = trials(tmp_path / "whole")
    assert len(whole) == TRIALS
    moments = random.Random(3)
    for kill in range(KILLS):
        here = (f"hydra.sweep.dir=search{kill}", f"tracking.uri=sqlite:///search{kill}.db")
        for _ in range(moments.choice((1, 2))):
            victim = start(tmp_path, *SEARCH, *here)
            time.sleep(moments.uniform(0.1, 1.0) * lasted)
            os.killpg(victim.pid, signal.SIGKILL)
            victim.communicate()
        out = carried_out(tmp_path, *here)
        assert [line.replace(f"search{kill}", "whole") for line in out.splitlines()[:2]] == best
        pd.testing.assert_frame_equal(trials(tmp_path / f"search{kill}"), whole)
        assert [run.info.status for run in mlflow_runs(tmp_path / f"search{kill}.db")] == ["FINISHED"] * TRIALS
