"""A worker of submitit in this process: what SIGUSR2 and SIGTERM do to its training, and how jobs are dealt."""

import os
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

from pinn_cli.main import run
from pinn_cli.sweep import submitit_launcher
from pinn_cli.sweep.launching import jobs_at_once
from pinn_cli.sweep.submitit_launcher import Batch, SlurmLauncher

ON_SIGNALS_ALONE = (*ADAM, "training.checkpoint_every_s=null", "hydra.run.dir=run")
REQUEUED = 144
# Of no sweep.
WORK: Any = None


@pytest.fixture(autouse=True)
def _quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_LOOK_EVERY_S", "_ASK_EVERY_S", "_SHOWN_S"):
        monkeypatch.setattr(submitit_launcher, name, 0.01)


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> Steps:
    without_figures(monkeypatch)
    return Steps(monkeypatch)


@pytest.fixture
def worker(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[DictConfig], list[Any]]]:
    """Runs a job as a task of SLURM does, with the handlers that submitit sets before."""
    monkeypatch.setattr(
        submitit_launcher, "in_worker", lambda work: SimpleNamespace(run=lambda config, *_: run(config))
    )
    monkeypatch.setattr(submitit_launcher.submitit, "JobEnvironment", lambda: SimpleNamespace(job_id="17_0"))
    mine = {signal.SIGUSR2: lambda number, frame: sys.exit(REQUEUED), signal.SIGTERM: signal.SIG_IGN}
    before = {number: signal.signal(number, handler) for number, handler in mine.items()}
    yield lambda config: Batch(WORK)([(config, 0)])
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
    done = pinn_run(*ON_SIGNALS_ALONE, "resume=auto", task=worker).done()
    assert steps.taken[0] == 12
    assert_same_numbers(whole, done.directory)


def test_a_training_that_is_warned_writes_a_checkpoint_and_goes_on(pinn_run: PinnRun, steps: Steps, worker) -> None:
    steps.signal_at(11, signal.SIGTERM)
    pinn_run(*ON_SIGNALS_ALONE, task=worker).done()
    assert steps.taken == list(range(31))
    assert iteration(Path("run/checkpoint.previous.pt")) == 12


class Task:
    """A task as submitit has it, in the current folder: with a result, or with none for ever."""

    def __init__(self, job_id: str = "17_0", returned: list[Any] | None = None) -> None:
        names = {"submitted_pickle": "submitted.pkl", "result_pickle": "result.pkl", "stderr": "log.err"}
        self.job_id, self.returned = job_id, returned
        self.paths = SimpleNamespace(**{name: Path.cwd() / f"{job_id}_{file}" for name, file in names.items()})
        if returned is not None:
            self.paths.result_pickle.touch()

    def results(self) -> list[Any]:
        return [self.returned]


def program(folder: Path, name: str, answer: str) -> None:
    (folder / name).write_text(f"#!/bin/sh\n{answer}\n")
    (folder / name).chmod(0o755)


@pytest.fixture
def squeue(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Has `squeue` list tasks, one line after the other; each list is printed once, the last one ever after."""
    folder = tmp_path_factory.mktemp("bin")
    monkeypatch.setenv("PATH", f"{folder}:/bin")

    def listing(*lists: str) -> None:
        for number, listed in enumerate(lists):
            (folder / f"list{number}").write_text(listed)
        last = len(lists) - 1
        counting = f"cat {folder}/list$n; [ $n -ge {last} ] || echo $((n + 1)) > {folder}/n"
        program(folder, "squeue", f"n=$(cat {folder}/n 2>/dev/null || echo 0)\n{counting}")

    return listing


def test_jobs_that_never_began_are_failed_rows(pinn_run: PinnRun, squeue, monkeypatch) -> None:
    squeue("a remark of the cluster's\n17_0|CANCELLED|x\n17_1|COMPLETING|x\n", "17_0|CANCELLED|x\n")
    monkeypatch.setattr(SlurmLauncher, "_submit", lambda _, batches: [Task(f"17_{n}") for n in range(len(batches))])
    done = pinn_run("--multirun", "hydra/launcher=slurm", *SMALL, "seed=0,1", "hydra.sweep.dir=sweep")
    assert done.status == 1
    assert "2 jobs: 2 failed" in done.out
    reasons = pd.read_csv("sweep/jobs.csv").set_index("seed")["reason"]
    for seed, state in enumerate(("CANCELLED", "ENDED")):
        place = Path.cwd() / f"17_{seed}_log.err"
        assert reasons[seed] == f"SLURM job 17_{seed} ended without a result, state {state}; {place}"


ON, OVER = ("RUNNING", "PENDING", "COMPLETING"), ("CANCELLED", "PREEMPTED", "TIMEOUT")


@pytest.mark.parametrize("state", [*ON, *OVER])
def test_a_task_is_waited_for_until_it_is_over(state: str, squeue, tmp_path, monkeypatch) -> None:
    """One that was preempted may be on its way back into the queue, which may fail to answer."""
    monkeypatch.chdir(tmp_path)
    squeue("17_0|PREEMPTED|x\n", f"17_0|{state}|x\n", f"17_0|{state}|x\n", "")
    assert SlurmLauncher(WORK)._ended([Task()]) == {"17_0": state if state in OVER else "ENDED"}


@pytest.mark.parametrize(
    ("resume", "sent"), [((), [[2]]), (("resume=auto",), [[2]]), (("resume=never",), [[0], [1], [2], [3]])]
)
def test_tasks_of_a_killed_launcher_are_waited_for(resume, sent, pinn_run, squeue, tmp_path, monkeypatch) -> None:
    """17_0 has jobs of this sweep; 17_1 has a result by now, 18 is another sweep's, 19 has one of this and another."""
    scripts = {"17_0": "sweep", "17_1": "sweep", "18": "other", "19": "sweep"}
    Path("sweep/.submitit").mkdir(parents=True)
    queued = "".join(f"{t}|RUNNING|{tmp_path}/{place}/.submitit/.submission_file.sh\n" for t, place in scripts.items())
    squeue(queued, "17_0|TIMEOUT|x\n")
    jobs_of = {"17_0": (0, 1), "17_1": (2,), "18": (3,), "19": (3, 4)}

    def found(folder: str, name: str) -> Task:
        assert folder == "sweep/.submitit/%j"
        calls = [([*SMALL, *resume, f"seed={seed}"], seed, {}) for seed in jobs_of[name]]
        task: Any = Task(name, [] if name == "17_1" else None)
        task.submission = lambda: SimpleNamespace(args=(calls,))
        return task

    arrays: list[list[int]] = []

    def submit(launcher: Any, batches: list[list[Any]]) -> list[Task]:
        arrays.extend([job.number for job in batch] for batch in batches)
        return [Task(f"20_{n}", [job.returned(finished=False) for job in b]) for n, b in enumerate(batches)]

    monkeypatch.setattr(submitit_launcher.submitit, "SlurmJob", found)
    monkeypatch.setattr(SlurmLauncher, "_submit", submit)
    sweep = ("hydra/launcher=slurm", "hydra.sweep.dir=sweep", "seed=0,1,2,3")
    done = pinn_run("--multirun", *SMALL, *resume, *sweep)
    assert arrays == sent
    waits = len(sent) < 4
    assert ("waiting for SLURM job 17, sent before; scancel 17 cancels it\n" in done.err) is waits
    assert done.status == int(waits)
    if waits:
        table = pd.read_csv("sweep/jobs.csv", keep_default_na=False).set_index("seed")
        assert list(table["status"]) == ["failed", "failed", "not started", "failed"]
        assert table["reason"].str.startswith("SLURM job 17_0 ended without a result, state TIMEOUT").sum() == 2


def test_a_squeue_that_does_not_answer_is_asked_again(squeue, tmp_path, monkeypatch, capsys) -> None:
    """The task is neither lost nor sent once more meanwhile."""
    monkeypatch.chdir(tmp_path)
    folder, task, asked = Path(os.environ["PATH"].partition(":")[0]), Task(), []

    def sleep(seconds: float) -> None:
        asked.append(seconds)
        if len(asked) == 1:
            program(folder, "squeue", "echo 'connect failure' >&2; exit 1")
        elif len(asked) == 5:
            squeue("17_0|TIMEOUT|x\n")

    monkeypatch.setattr(submitit_launcher.time, "sleep", sleep)
    monkeypatch.setattr(submitit_launcher, "_ASK_EVERY_S", 0.0)
    assert SlurmLauncher(WORK)._ended([task]) == {"17_0": "TIMEOUT"}
    assert capsys.readouterr().err == "squeue does not answer, and is asked again (connect failure)\n"


@pytest.mark.parametrize("answer", ["", "echo 'invalid partition specified: nowhere' >&2; exit 1"])
def test_a_slurm_that_is_not_there_or_refuses_is_told_in_one_line(answer: str, pinn_run, tmp_path, monkeypatch) -> None:
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in ("srun", "sbatch") if answer else ():
        program(programs, name, answer)
    monkeypatch.setenv("PATH", f"{programs}:/bin" if answer else str(programs))
    done = pinn_run("--multirun", "hydra/launcher=slurm", *SMALL, "seed=0,1", "hydra.sweep.dir=sweep")
    assert done.status == 2
    line = done.err.splitlines()[-1]
    assert line.startswith("pinn-run: hydra/launcher=slurm: must be one that takes these jobs; ")
    assert ("nowhere" if answer else 'Could not detect "srun"') in line
    assert not (tmp_path / "sweep").exists()


def test_an_option_of_sbatch_can_be_left_out(monkeypatch) -> None:
    given: dict[str, Any] = {}
    executor = SimpleNamespace(update_parameters=given.update)
    monkeypatch.setattr(submitit_launcher.submitit, "AutoExecutor", lambda **init: executor)
    SlurmLauncher(WORK, submitit_folder="x", additional_parameters={"requeue": False, "mail-type": "END"})._executor()
    assert given == {"slurm_additional_parameters": {"mail-type": "END"}}


@pytest.mark.slow
def test_processes_of_this_machine(pinn_run: PinnRun, tmp_path: Path) -> None:
    sweep = ("--multirun", "hydra/launcher=workstation", *SMALL, "seed=0,1,2", "hydra.sweep.dir=sweep")
    done = pinn_run(*sweep).done()
    assert "3 jobs: 3 finished" in done.out
    tasks = {file.parent.name for file in tmp_path.glob("sweep/.submitit/*/*_submitted.pkl")}
    assert len(tasks) == min(3, jobs_at_once(1))
    assert pinn_run(*sweep).status == 0
    assert {file.parent.name for file in tmp_path.glob("sweep/.submitit/*/*_submitted.pkl")} == tasks
