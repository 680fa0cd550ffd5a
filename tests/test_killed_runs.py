"""SIGKILL at any moment: resumed, a run ends with the numbers of one that was never stopped, bit for bit."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from interrupted_runs import ADAM, assert_same_numbers, in_a_child, run_in_a_child

from pinn_cli.cli.command_line import execute
from pinn_cli.main import run
from pinn_cli.report import figures

KILLS = 24
# Long enough for a random moment to lie in it, with a checkpoint every few steps.
LONGER = (*ADAM, "training.iterations=120", "training.checkpoint_every_s=0.03")


def start(*arguments: str) -> int:
    """A run in a fork of this process, which goes on beside it; its process id."""
    child = os.fork()
    if child == 0:
        try:
            figures.write_figures = lambda *args, **kwargs: None
            sys.argv = ["pinn-run", *arguments]
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 1)
            os.dup2(null, 2)
            os._exit(execute(run))
        finally:
            os._exit(1)
    return child


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float]:
    """The run undisturbed, and how long it trains, s."""
    # The first step of any optimiser imports for seconds: here, so that every fork has done so.
    torch.optim.Adam([torch.zeros(1, requires_grad=True)]).step()
    directory = run_in_a_child(tmp_path_factory.mktemp("undisturbed") / "whole", *LONGER)
    return directory, float(json.loads((directory / "run.json").read_text())["seconds"]["estimate"])


def await_training(log: Path, told: int) -> None:
    """Until the log says so many times that the stage before it has ended, or for a minute."""
    until = time.perf_counter() + 60.0
    while time.perf_counter() < until and (log.read_text() if log.exists() else "").count("problem:") < told:
        time.sleep(0.005)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(KILLS))
def test_killed_at_random_moments(number: int, whole: tuple[Path, float], tmp_path: Path, monkeypatch) -> None:
    """One kill each, in an equal part of the training and what follows; some are killed again, at any moment."""
    directory, seconds = whole
    monkeypatch.chdir(tmp_path)
    moments = random.Random(number)
    arguments = (*LONGER, "hydra.run.dir=run", "resume=auto")
    child = start(*arguments)
    await_training(tmp_path / "run" / "pinn-run.log", 1)
    time.sleep(1.1 * seconds * (number + moments.random()) / KILLS)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    if number % 4 == 0:
        child = start(*arguments)
        time.sleep(5.0 * moments.random())
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    child = start(*(("resume=run",) if number % 2 else arguments))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert_same_numbers(directory, tmp_path / "run")
    assert not list((tmp_path / "run").rglob(".*.partial*"))


@pytest.mark.slow
def test_killed_in_a_process_of_its_own(whole: tuple[Path, float], tmp_path: Path) -> None:
    """As a user's machine does it: another process takes over, which shares no memory with the first."""
    program = [sys.executable, "-m", "pinn_cli.main"]
    killed = subprocess.Popen([*program, *LONGER, "hydra.run.dir=run"], cwd=tmp_path)
    while killed.poll() is None and not (tmp_path / "run" / "checkpoint.previous.pt").exists():
        time.sleep(0.01)
    killed.kill()
    assert killed.wait() == -signal.SIGKILL
    done = subprocess.run([*program, "resume=run"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "going on from the checkpoint" in (tmp_path / "run" / "pinn-run.log").read_text()
    assert_same_numbers(whole[0], tmp_path / "run")


@pytest.mark.slow
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_to_a_process_of_its_own(number: int, status: int, tmp_path: Path) -> None:
    # Started from a shell's background job, a process ignores SIGINT: here it must not.
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); import pinn_cli.main as m; m.main()"
    )
    endless = ("training.iterations=1000000", "training.checkpoint_every_s=null")
    program = [sys.executable, "-c", code, *LONGER, "hydra.run.dir=run", *endless]
    process = subprocess.Popen(program, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    log = tmp_path / "run" / "pinn-run.log"
    while process.poll() is None and "problem:" not in (log.read_text() if log.exists() else ""):
        time.sleep(0.01)
    time.sleep(4.0)  # torch's optimisers take seconds to import, and before the first step there is nothing to keep
    process.send_signal(number)
    _, err = process.communicate()
    assert process.returncode == status
    assert err == "pinn-run: interrupted; to go on: pinn-run resume=run\n"


def test_a_child_tells_how_it_ended() -> None:
    assert in_a_child(lambda: os.kill(os.getpid(), signal.SIGKILL)) == -signal.SIGKILL
    assert in_a_child(lambda: None) == 0
