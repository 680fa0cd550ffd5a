"""Sweeps on a real SLURM: preemption, requeue, cancelled jobs, and launchers that are killed."""

import json
import os
import re
import signal
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
from interrupted_runs import ADAM, assert_same_numbers
from slurm import Cluster, await_that, slurm

TINY = ("system.ndof=2", "simulation.duration=5", "simulation.samples=256")
# Long enough to be disturbed on the way, some seconds on one core.
LONGER = (*ADAM, "training.iterations=1000", "training.history_every=50", "training.checkpoint_every_s=0.5")
LAUNCHER = ("hydra/launcher=slurm", "hydra.launcher.mem_gb=null", "hydra.sweep.dir=sweep")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def environment() -> Iterator[dict[str, str]]:
    with slurm() as environment:
        yield environment


@pytest.fixture
def cluster(environment: dict[str, str], tmp_path: Path) -> Cluster:
    return Cluster(environment, tmp_path)


def job(cluster: Cluster, seed: int) -> Path:
    (directory,) = (cluster.folder / "sweep").glob(f"seed={seed}_*")
    return directory


def log(directory: Path) -> str:
    return (directory / "pinn-run.log").read_text()


def jobs(cluster: Cluster) -> pd.DataFrame:
    return pd.read_csv(cluster.folder / "sweep" / "jobs.csv", keep_default_na=False).set_index("seed")


def test_preempted_and_requeued_jobs_go_on_and_a_cancelled_one_takes_no_other_along(cluster: Cluster) -> None:
    launcher = cluster.start(*LAUNCHER, *LONGER, "seed=0,1,2")
    await_that(lambda: len(list(cluster.folder.glob("sweep/seed=*/checkpoint.previous.pt"))) == 3)
    array = cluster.tasks()[0].partition("_")[0]
    cluster.call("scancel", "--signal=USR2", f"{array}_0")
    cluster.call("scontrol", "requeue", f"{array}_1")
    cluster.call("scancel", f"{array}_2")
    assert launcher.wait() == 1, cluster.said()
    table = jobs(cluster)
    assert list(table["status"]) == ["finished", "finished", "failed"]
    assert "CANCELLED" in table["reason"][2]
    (told,) = cluster.folder.glob(f"sweep/.submitit/{array}_0/*_log.err")
    assert "this job is preempted" in told.read_text()
    for seed in (0, 1):
        assert "going on from the checkpoint" in log(job(cluster, seed))

    assert cluster.sweep(*LAUNCHER, *LONGER, "seed=0,1,2") == 0, cluster.said()
    assert "2 of 3 jobs are finished already" in cluster.said()
    assert "1 jobs as SLURM job" in cluster.said()
    assert list(jobs(cluster)["status"]) == ["finished"] * 3
    assert "going on from the checkpoint" in log(job(cluster, 2))

    assert cluster.sweep(*LONGER, "seed=0,1,2", "hydra.sweep.dir=alone") == 0, cluster.said()
    for seed in (0, 1, 2):
        assert_same_numbers(cluster.folder / "alone" / job(cluster, seed).name, job(cluster, seed))


def test_a_killed_task_takes_its_own_jobs_along_which_the_same_command_runs(cluster: Cluster) -> None:
    sweep = (*LAUNCHER, *LONGER, "hydra.launcher.jobs_per_task=2", "seed=range(4)")
    launcher = cluster.start(*sweep)
    await_that(lambda: bool(list(cluster.folder.glob("sweep/seed=0_*/checkpoint.previous.pt"))))
    os.kill(json.loads((job(cluster, 0) / "run.lock").read_text())["pid"], signal.SIGKILL)
    assert launcher.wait() == 1, cluster.said()
    table = jobs(cluster)
    assert list(table["status"]) == ["failed", "failed", "finished", "finished"]
    assert table["reason"].str.contains("state FAILED").sum() == 2
    assert cluster.sweep(*sweep) == 0, cluster.said()
    assert [log(job(cluster, seed)).count("estimate:") for seed in range(4)] == [1, 1, 1, 1]
    assert "going on from the checkpoint" in log(job(cluster, 0))


def test_twelve_jobs_survive_a_cancellation_a_requeue_and_the_death_of_their_launcher(cluster: Cluster) -> None:
    sweep = (*LAUNCHER, *TINY, "seed=range(12)")
    launcher = cluster.start(*sweep)
    await_that(lambda: len(list(cluster.folder.glob("sweep/seed=*/run.json"))) >= 2)
    cancelled, requeued = cluster.tasks("RUNNING")[:2]
    cluster.call("scancel", cancelled)
    cluster.call("scontrol", "requeue", requeued)
    launcher.send_signal(signal.SIGKILL)
    assert launcher.wait() == -signal.SIGKILL
    array = cluster.tasks()[0].partition("_")[0]

    assert cluster.sweep(*sweep) == 0, cluster.said()
    assert f"waiting for SLURM job {array}, sent before" in cluster.said()
    first, *later = map(int, re.findall(r"(\d+) jobs as SLURM job", cluster.said()))
    assert first == 12
    assert sum(later) <= 2  # the cancelled one, and the other if it was just being requeued
    table = jobs(cluster)
    assert list(table.index) == list(range(12))
    assert set(table["status"]) == {"finished"}
    fitness = pd.read_csv(cluster.folder / "sweep" / "fitness.csv")
    rows = Counter(fitness["seed"])
    assert sorted(rows) == list(range(12))
    assert len(set(rows.values())) == 1, rows
    # A task that was requeued as it ended runs once more, and finds its job finished.
    await_that(lambda: not cluster.tasks())
    assert not list(cluster.folder.glob("sweep/*/run.lock"))
    assert sum(log(job(cluster, seed)).count("estimate:") for seed in range(12)) <= 14


def test_a_cancelled_array_is_known_soon_and_runs_again(cluster: Cluster) -> None:
    launcher = cluster.start(*LAUNCHER, "hydra.launcher.jobs_per_task=2", *TINY, "seed=range(8)")
    await_that(lambda: len(list(cluster.folder.glob("sweep/seed=*/pinn-run.log"))) >= 1)
    start = time.monotonic()
    cluster.call("scancel", cluster.tasks()[0].partition("_")[0])
    assert launcher.wait() == 1, cluster.said()
    assert time.monotonic() - start < 90.0
    table = jobs(cluster)
    assert len(table) == 8
    assert set(table["status"]) <= {"failed", "finished"}
    assert cluster.sweep(*LAUNCHER, "hydra.launcher.jobs_per_task=4", *TINY, "seed=range(8)") == 0, cluster.said()
    assert set(jobs(cluster)["status"]) == {"finished"}
