"""A worker of submitit in this process: what SIGUSR2 and SIGTERM do to its training, and how jobs are dealt."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest
import torch
from calls import SMALL, PinnRun
from interrupted_runs import ADAM, Steps, assert_same_numbers, without_figures
from omegaconf import DictConfig

pytest.importorskip("submitit", reason="not installed: pip install 'pinn-cli[slurm]'")

from submitit import SlurmJob as SubmititJob
from submitit.core.utils import UncompletedJobError
from submitit.slurm.slurm import SlurmInfoWatcher

from pinn_cli.main import run
from pinn_cli.sweep import submitit_launcher
from pinn_cli.sweep.affinity import jobs_at_once
from pinn_cli.sweep.slurm_states import QueueWatcher, choose_watcher
from pinn_cli.sweep.submitit_launcher import LocalLauncher, SlurmLauncher

ON_SIGNALS_ALONE = (*ADAM, "training.checkpoint_every_s=null", "hydra.run.dir=run")
REQUEUED = 144
# Of no sweep.
WORK: Any = None


@pytest.fixture(autouse=True)
def _watcher(monkeypatch: pytest.MonkeyPatch) -> None:
    """Submitit's own, and again after the test: one is shared by all jobs."""
    monkeypatch.setattr(SubmititJob, "watcher", SlurmInfoWatcher())


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> Steps:
    without_figures(monkeypatch)
    return Steps(monkeypatch)


@pytest.fixture
def worker(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[DictConfig], list[Any]]]:
    """Runs a job as a task of SLURM does, with the handlers that submitit sets before."""
    monkeypatch.setattr(SlurmLauncher, "_run", lambda launcher, config: run(config))
    mine = {signal.SIGUSR2: lambda number, frame: sys.exit(REQUEUED), signal.SIGTERM: signal.SIG_IGN}
    before = {number: signal.signal(number, handler) for number, handler in mine.items()}
    yield lambda config: SlurmLauncher(WORK, jobs_per_task=1)([(config,)])
    assert {number: signal.signal(number, handler) for number, handler in before.items()} == mine


def iteration(checkpoint: Path) -> int:
    return int(torch.load(checkpoint, weights_only=True)["trainings"][0]["state"]["iteration"])


def test_a_preempted_training_leaves_once_its_checkpoint_is_written(pinn_run: PinnRun, steps: Steps, worker) -> None:
    whole = pinn_run(*ADAM, "hydra.run.dir=whole").directory
    steps.signal_at(11, signal.SIGUSR2)
    assert pinn_run(*ON_SIGNALS_ALONE, task=worker).status == REQUEUED
    assert steps.taken[-1] == 11
    assert iteration(Path("run/checkpoint.pt")) == 12
    steps.undisturbed()
    done = pinn_run(*ON_SIGNALS_ALONE, "resume=auto", task=worker)
    assert done.status == 0, done.err
    assert steps.taken[0] == 12
    assert_same_numbers(whole, done.directory)


def test_a_training_that_is_warned_writes_a_checkpoint_and_goes_on(pinn_run: PinnRun, steps: Steps, worker) -> None:
    steps.signal_at(11, signal.SIGTERM)
    done = pinn_run(*ON_SIGNALS_ALONE, task=worker)
    assert done.status == 0, done.err
    assert steps.taken == list(range(31))
    assert iteration(Path("run/checkpoint.previous.pt")) == 12


@pytest.mark.parametrize(
    ("launcher", "batches"),
    [
        (SlurmLauncher(WORK), [[0], [1], [2], [3], [4]]),
        (SlurmLauncher(WORK, jobs_per_task=2), [[0, 1], [2, 3], [4]]),
        (LocalLauncher(WORK, jobs_per_task=3), [[0, 1, 2], [3, 4]]),
        (LocalLauncher(WORK), [[0, 2, 4], [1, 3]]),
        (LocalLauncher(WORK, jobs_per_task=0, cpus_per_task=2), [[0, 1, 2, 3, 4]]),
    ],
)
def test_jobs_are_dealt_to_tasks(launcher: Any, batches: list[list[int]], monkeypatch) -> None:
    monkeypatch.setattr(submitit_launcher, "jobs_at_once", lambda threads: 2 // threads)
    jobs = [SimpleNamespace(number=number) for number in range(5)]
    assert [[job.number for job in batch] for batch in launcher._batches(jobs)] == batches


class SlurmJob:
    """A task that was lost, unless it has results, as submitit tells of it."""

    job_id = "17_0"
    _results_timeout_s = 15.0
    waited = 0.0

    def __init__(self, state: str = "CANCELLED by 0", results: list[Any] | None = None) -> None:
        names = {"submitted_pickle": "17_0_submitted.pkl", "result_pickle": "17_0_0_result.pkl"}
        self.paths = SimpleNamespace(stderr="17_0_0_log.err", **{name: Path(file) for name, file in names.items()})
        self.state, self.returned = state, results

    def wait(self) -> None:
        pass

    def done(self) -> bool:
        return True

    def results(self) -> list[Any]:
        if self.returned is not None:
            return [self.returned]
        SlurmJob.waited += self._results_timeout_s
        raise UncompletedJobError(f"Job 17_0 has not produced any output (state: {self.state})")


def test_jobs_that_never_began_are_failed_rows(pinn_run: PinnRun, monkeypatch) -> None:
    monkeypatch.setattr(SlurmLauncher, "_submit", lambda launcher, batches: [SlurmJob() for _ in batches])
    done = pinn_run("--multirun", "hydra/launcher=slurm", *SMALL, "seed=0,1", "hydra.sweep.dir=sweep")
    assert done.status == 1
    assert "2 jobs: 2 failed" in done.out
    assert SlurmJob.waited == 15.0
    table = pd.read_csv("sweep/jobs.csv")
    assert list(table["seed"]) == [0, 1]
    assert set(table["reason"]) == {"SLURM job 17_0 ended without a result, state CANCELLED by 0; 17_0_0_log.err"}


@pytest.mark.parametrize(
    ("state", "begun", "sent"),
    [
        ("OUT_OF_MEMORY", 2, [[0, 1, 2, 3], [2, 3]]),
        ("OUT_OF_MEMORY", 4, [[0, 1, 2, 3]]),
        ("NODE_FAIL", 0, [[0, 1, 2, 3]]),  # the task itself cannot run: nor could another one
        ("CANCELLED by 0", 2, [[0, 1, 2, 3]]),
        ("ENDED", 2, [[0, 1, 2, 3]]),  # forgotten by a cluster without accounts: perhaps it was cancelled
    ],
)
def test_jobs_behind_a_killed_one_are_sent_again(state: str, begun: int, sent: list[list[int]], pinn_run, monkeypatch):
    arrays: list[list[int]] = []

    def submit(launcher: Any, batches: list[list[Any]]) -> list[SlurmJob]:
        (batch,) = batches
        arrays.append([job.number for job in batch])
        if len(arrays) > 1:
            return [SlurmJob("COMPLETED", [job.returned(finished=False) for job in batch])]
        Path("17_0_submitted.pkl").touch()
        for job in batch[:begun]:
            (job.directory / ".hydra").mkdir(parents=True)
            (job.directory / ".hydra" / "overrides.yaml").write_text(f"- seed={job.number}\n")
        return [SlurmJob(state)]

    monkeypatch.setattr(SlurmLauncher, "_submit", submit)
    sweep = ("hydra/launcher=slurm", "hydra.launcher.jobs_per_task=4", "hydra.sweep.dir=sweep", "seed=0,1,2,3")
    done = pinn_run("--multirun", *SMALL, *sweep)
    assert arrays == sent
    again = sent[-1] if len(sent) > 1 else []
    assert ("2 jobs were behind one that was killed" in done.err) is bool(again)
    table = pd.read_csv("sweep/jobs.csv", keep_default_na=False).set_index("seed")
    assert set(table.index[table["status"] == "failed"]) == {0, 1, 2, 3} - set(again)
    assert table["reason"].str.contains(state).sum() == 4 - len(again)


@pytest.mark.parametrize(
    ("resume", "sent"), [((), [[2], [3]]), (("resume=auto",), [[2], [3]]), (("resume=never",), [[0], [1], [2], [3]])]
)
def test_tasks_of_a_killed_launcher_are_waited_for(resume: tuple[str, ...], sent, pinn_run, tmp_path, monkeypatch):
    """17_0 has jobs of this sweep; 17_1 has a result by now, 18 is another sweep's, 19 has a job not asked for."""
    scripts = {"17_0": "sweep", "17_1": "sweep", "18": "other", "19": "sweep"}
    listed = "\n".join(f"{task}|{tmp_path}/{place}/.submitit/.submission_file.sh" for task, place in scripts.items())
    for name, answer in {"sacct": "exit 0", "squeue": f"echo '{listed}'"}.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{answer}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin")
    jobs_of = {"17_0": (0, 1), "17_1": (2,), "18": (3,), "19": (3, 4)}
    (tmp_path / "17_1_0_result.pkl").touch()

    def queued(folder: str, task: str) -> SlurmJob:
        assert folder == "sweep/.submitit/%j"
        calls = [([*SMALL, *resume, f"seed={seed}"], seed, {}) for seed in jobs_of[task]]
        job = SlurmJob("TIMEOUT")
        job.job_id, job.submission = task, lambda: SimpleNamespace(args=(calls,))
        job.paths.result_pickle = tmp_path / f"{task}_0_result.pkl"
        return job

    arrays: list[list[int]] = []

    def submit(launcher: Any, batches: list[list[Any]]) -> list[SlurmJob]:
        arrays.extend([job.number for job in batch] for batch in batches)
        return [SlurmJob("COMPLETED", [job.returned(finished=False) for job in batch]) for batch in batches]

    monkeypatch.setattr(submitit_launcher.submitit, "SlurmJob", queued)
    monkeypatch.setattr(SlurmLauncher, "_submit", submit)
    sweep = ("hydra/launcher=slurm", "hydra.sweep.dir=sweep", "seed=0,1,2,3")
    done = pinn_run("--multirun", *SMALL, *resume, *sweep)
    assert arrays == sent
    waits = len(sent) < 4
    assert ("waiting for SLURM job 17, sent before; scancel 17 cancels it\n" in done.err) is waits
    assert done.status == int(waits)
    if waits:
        table = pd.read_csv("sweep/jobs.csv", keep_default_na=False).set_index("seed")
        assert list(table["status"]) == ["failed", "failed", "not started", "not started"]
        assert table["reason"].str.startswith("SLURM job 17_0 ended without a result, state TIMEOUT").sum() == 2


@pytest.mark.parametrize("answer", ["", "echo 'invalid partition specified: nowhere' >&2; exit 1"])
def test_a_slurm_that_is_not_there_or_refuses_is_told_in_one_line(answer: str, pinn_run, tmp_path, monkeypatch) -> None:
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in ("srun", "sbatch") if answer else ():
        (programs / name).write_text(f"#!/bin/sh\n{answer}\n")
        (programs / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}:/bin" if answer else str(programs))
    done = pinn_run("--multirun", "hydra/launcher=slurm", *SMALL, "seed=0,1", "hydra.sweep.dir=sweep")
    assert done.status == 2
    line = done.err.splitlines()[-1]
    assert line.startswith("pinn-run: hydra/launcher=slurm: must be one that takes these jobs; ")
    assert ("nowhere" if answer else 'Could not detect "srun"') in line
    assert not (tmp_path / "sweep").exists()


STATES = {
    "17_0": ("RUNNING", False),
    "17_1": ("CANCELLED by 0", True),
    "17_2": ("PREEMPTED", True),
    "17_3": ("PREEMPTED", False),  # and on its way back into the queue
    "17_4": ("SUSPENDED", False),
    "17_5": ("CONFIGURING", False),
    "17_6": ("PENDING", False),
    "17_7": ("OUT_OF_MEMORY", True),
}


@pytest.mark.parametrize("accounts", [True, False])
def test_states_of_tasks(accounts: bool, tmp_path: Path, monkeypatch) -> None:
    states = {task: state for task, (state, _) in STATES.items()}
    told = "\n".join(["JobID|State|NodeList", *(f"{task}|{state}|vm" for task, state in states.items())])
    listed = "\n".join(f"{task}|{state.split()[0]}" for task, state in states.items())
    programs = {
        "sacct": f"echo '{told}'" if accounts else "exit 1",
        "squeue": f"case \"$*\" in *states=all*) echo '{listed}';; *) echo 17_3; echo 17_6;; esac",
    }
    for name, answer in programs.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{answer}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin")
    choose_watcher()
    assert isinstance(SubmititJob.watcher, QueueWatcher) is not accounts
    tasks = [SubmititJob(tmp_path, task) for task in STATES]
    assert [task.done() for task in tasks] == [done for _, done in STATES.values()]
    assert [task.state.split()[0] for task in tasks] == [state.split()[0] for state in states.values()]
    if not accounts:
        assert SubmititJob(tmp_path, "17_8").state == "ENDED"
    (tmp_path / "squeue").write_text("#!/bin/sh\nexit 1\n")
    assert not SubmititJob.watcher.is_done("17_2", mode="cache")  # nobody knows whether it comes back


def test_an_option_of_sbatch_can_be_left_out(monkeypatch) -> None:
    given: dict[str, Any] = {}
    executor = SimpleNamespace(update_parameters=given.update)
    monkeypatch.setattr(submitit_launcher.submitit, "AutoExecutor", lambda **init: executor)
    monkeypatch.setattr(submitit_launcher, "choose_watcher", lambda: None)
    SlurmLauncher(WORK, submitit_folder="x", additional_parameters={"requeue": False, "mail-type": "END"})._executor()
    assert given == {"slurm_additional_parameters": {"mail-type": "END"}}


@pytest.mark.slow
def test_processes_of_this_machine(pinn_run: PinnRun, tmp_path: Path) -> None:
    sweep = ("--multirun", "hydra/launcher=workstation", *SMALL, "seed=0,1,2", "hydra.sweep.dir=sweep")
    done = pinn_run(*sweep)
    assert done.status == 0, done.err
    assert "3 jobs: 3 finished" in done.out
    tasks = {file.parent.name for file in tmp_path.glob("sweep/.submitit/*/*_submitted.pkl")}
    assert len(tasks) == min(3, jobs_at_once(1))
    assert pinn_run(*sweep).status == 0
    assert {file.parent.name for file in tmp_path.glob("sweep/.submitit/*/*_submitted.pkl")} == tasks
