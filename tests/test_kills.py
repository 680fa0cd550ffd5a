"""`make kills`: 100 runs and 30 sweeps killed, 10 full disks; the same command then ends with the same numbers.

Bit for bit, the column of seconds apart. A run is a fork of this process, which has imported everything, so that it
takes a second or two; workers of joblib are processes of their own.
"""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest
import torch
from interrupted_runs import ADAM, assert_same_numbers, run_in_a_child
from sweeps import start as start_process

from pinn_cli.cli.command_line import execute
from pinn_cli.main import run
from pinn_cli.report import figures

pytestmark = pytest.mark.slow

AT_ANY_MOMENT, IN_CHECKPOINTS, IN_REPORTS = 50, 25, 25
SWEEPS, SWEEPS_OF_WORKERS, FULL_DISKS = 22, 8, 10
COMMAND = (*ADAM, "training.iterations=60", "training.checkpoint_every_s=0.02", "hydra.run.dir=run", "resume=auto")
# Long enough for another process to see it train.
LONG = (*ADAM, "training.iterations=120", "training.checkpoint_every_s=0.03")
SWEEP = ("--multirun", *ADAM, "training.iterations=20", "training.checkpoint_every_s=0.02", "seed=0,1,2")
REPORT = ("free_run.csv", "fitness.csv", "parameters.csv", "residuals.csv", "history.csv", "response.nc", "run.json")

Hook = Callable[[], None]


def start(folder: Path, *arguments: str, hook: Hook = lambda: None) -> int:
    """A command in a fork of this process; its process id."""
    child = os.fork()
    if child == 0:
        try:
            os.chdir(folder)
            figures.write_figures = lambda *args, **kwargs: None
            sys.argv = ["pinn-run", *arguments]
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 1)
            os.dup2(null, 2)
            sys.stdout = sys.stderr = os.fdopen(null, "w")
            hook()
            os._exit(execute(run))
        finally:
            os._exit(99)
    return child


def ended(child: int) -> int:
    """Its exit status, negative for a signal."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def killed_after(child: int, seconds: float) -> bool:
    """Kill it then; False if it had ended by itself."""
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    return ended(child) == -signal.SIGKILL


def dying_at(is_it: Callable[[Path], bool], number: int, after: bool) -> Hook:
    """Have the process be killed before or after the so many-th file of that kind gets its name."""

    def hook() -> None:
        replace, seen = os.replace, [0]

        def replace_and_die(source: str, target: str) -> None:
            seen[0] += is_it(Path(target))
            dies = is_it(Path(target)) and seen[0] == number
            if dies and not after:
                os.kill(os.getpid(), signal.SIGKILL)
            replace(source, target)
            if dies:
                os.kill(os.getpid(), signal.SIGKILL)

        os.replace = replace_and_die  # type: ignore[assignment]

    return hook


def await_file(file: Path) -> None:
    until = time.monotonic() + 60.0
    while time.monotonic() < until and not file.exists():
        time.sleep(0.002)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float]:
    """The run undisturbed, and how long it takes, s."""
    torch.optim.Adam([torch.zeros(1, requires_grad=True)]).step()  # its first step imports for seconds
    folder = tmp_path_factory.mktemp("undisturbed")
    assert ended(start(folder, *COMMAND)) == 0
    began = time.perf_counter()
    assert ended(start(folder, *COMMAND, "resume=never")) == 0
    return folder / "run", time.perf_counter() - began


def assert_ends_the_same(folder: Path, whole: Path, command: tuple[str, ...] = COMMAND) -> None:
    assert ended(start(folder, *command)) == 0
    assert_same_numbers(whole, folder / "run")
    assert (folder / "run" / "residuals.csv").read_bytes() == (whole / "residuals.csv").read_bytes()
    assert not list(folder.rglob("*.partial*"))


def test_a_hundred_kills_of_runs(whole: tuple[Path, float], tmp_path: Path) -> None:
    directory, seconds = whole
    stages = json.loads((directory / "run.json").read_text())["seconds"]
    lasting = stages["total"] - sum(stages[name] for name in ("config", "imports", "record", "problem"))
    moments, counted = random.Random(16), Counter[str]()

    def check(kind: str, number: int, victim: int, after: float = 0.0) -> None:
        folder = tmp_path / f"{kind}{number}"
        was_killed = killed_after(victim, after) if after else ended(victim) == -signal.SIGKILL
        counted[f"{kind}, killed"] += was_killed
        counted["with a checkpoint on the disk"] += was_killed and bool(list(folder.glob("run/checkpoint*.pt")))
        if number % 4 == 0 and was_killed:
            counted["killed twice"] += killed_after(start(folder, *COMMAND), moments.uniform(0.0, seconds))
        by_directory = number % 2 and (folder / "run" / ".hydra" / "config.yaml").is_file()
        assert_ends_the_same(folder, directory, ("resume=run",) if by_directory else COMMAND)

    number = 0
    while counted["any moment, killed"] < AT_ANY_MOMENT:
        (tmp_path / f"any moment{number}").mkdir()
        victim = start(tmp_path / f"any moment{number}", *COMMAND)
        if number % 5:  # in its training or its report; else in anything
            await_file(tmp_path / f"any moment{number}" / "run" / "checkpoint.pt")
            check("any moment", number, victim, moments.uniform(0.0, 0.95) * lasting)
        else:
            check("any moment", number, victim, moments.uniform(0.05, 0.98) * seconds)
        number += 1
    for number in range(IN_CHECKPOINTS):
        (tmp_path / f"checkpoints{number}").mkdir()
        hook = dying_at(lambda file: file.name.startswith("checkpoint"), moments.randint(3, 30), bool(number % 2))
        check("checkpoints", number, start(tmp_path / f"checkpoints{number}", *COMMAND, hook=hook))
    for number in range(IN_REPORTS):
        (tmp_path / f"reports{number}").mkdir()
        name = REPORT[number % len(REPORT)]
        hook = dying_at(lambda file, name=name: file.name == name, 1, after=number >= IN_REPORTS // 2)
        check("reports", number, start(tmp_path / f"reports{number}", *COMMAND, hook=hook))
    print(dict(counted))
    kills = sum(counted[f"{kind}, killed"] for kind in ("any moment", "checkpoints", "reports"))
    assert kills == AT_ANY_MOMENT + IN_CHECKPOINTS + IN_REPORTS
    assert counted["with a checkpoint on the disk"] >= 80


def assert_same_sweep(one: Path, other: Path) -> None:
    for name in ("fitness.csv", "parameters.csv", "summary.csv", "residuals.csv"):
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    for job in one.glob("seed=*"):
        assert_same_numbers(job, other / job.name)
    assert not list(other.rglob("*.partial*"))


def test_killed_sweeps(whole: tuple[Path, float], tmp_path: Path) -> None:
    """In one process, and with workers, of whom none must outlive the process that started them."""
    moments = random.Random(30)
    assert ended(start(tmp_path, *SWEEP, "hydra.sweep.dir=whole")) == 0
    began = time.perf_counter()
    assert ended(start(tmp_path, *SWEEP, "resume=never", "hydra.sweep.dir=whole")) == 0
    seconds, kills, number = time.perf_counter() - began, 0, 0
    while kills < SWEEPS:
        place = f"hydra.sweep.dir=sweep{number}"
        kills += killed_after(start(tmp_path, *SWEEP, place), moments.uniform(0.1, 0.98) * seconds)
        assert ended(start(tmp_path, *SWEEP, place)) == 0
        assert_same_sweep(tmp_path / "whole", tmp_path / f"sweep{number}")
        number += 1
    workers = 0
    for number in range(SWEEPS_OF_WORKERS):
        command = (*SWEEP, "hydra/launcher=joblib", "hydra.launcher.n_jobs=2", f"hydra.sweep.dir=workers{number}")
        victim = start_process(tmp_path, *command)
        until = time.monotonic() + moments.uniform(0.0, 3.0)
        while not list(tmp_path.glob(f"workers{number}/*/checkpoint.pt")) or time.monotonic() < until:
            assert victim.poll() is None
            time.sleep(0.02)
        children = psutil.Process(victim.pid).children(recursive=True)
        workers += len(children)
        victim.kill()
        victim.communicate()
        _, alive = psutil.wait_procs(children, timeout=10)
        assert not alive, alive
        again = start_process(tmp_path, *command)
        _, err = again.communicate(timeout=600)
        assert again.returncode == 0, err
        assert_same_sweep(tmp_path / "whole", tmp_path / f"workers{number}")
    print(f"{kills} sweeps in one process and {SWEEPS_OF_WORKERS} with {workers} workers were killed")


def test_full_disks(whole: tuple[Path, float], tmp_path: Path) -> None:
    """A disk of its own for each run, and then more space on it."""
    told = Counter[int]()
    for number in range(FULL_DISKS):
        disk = tmp_path / f"disk{number}"
        disk.mkdir()
        size = 24 + 12 * number
        mount = ["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", str(disk)]
        if subprocess.run(mount, capture_output=True).returncode:
            pytest.skip("only root may mount a small disk")
        try:
            status = ended(start(disk, *COMMAND))
            assert status in (2, 3), (size, status)
            assert not list(disk.rglob("*.partial*"))
            told[status] += 1
            subprocess.run(["mount", "-o", "remount,size=16m", str(disk)], check=True)
            assert_ends_the_same(disk, whole[0])
        finally:
            subprocess.run(["umount", "-l", str(disk)], check=True)
    print(f"full disks by exit status: {dict(told)}")
    assert sum(told.values()) == FULL_DISKS


def test_killed_in_a_process_of_its_own(tmp_path: Path) -> None:
    """As a user's machine does it: another process takes over, which shares no memory with the first."""
    killed = start_process(tmp_path, *LONG, "hydra.run.dir=run")
    while killed.poll() is None and not (tmp_path / "run" / "checkpoint.previous.pt").exists():
        time.sleep(0.01)
    killed.kill()
    assert killed.wait() == -signal.SIGKILL
    again = start_process(tmp_path, "resume=run")
    _, err = again.communicate()
    assert again.returncode == 0, err
    assert "going on from the checkpoint" in (tmp_path / "run" / "pinn-run.log").read_text()
    assert_same_numbers(run_in_a_child(tmp_path / "whole", *LONG), tmp_path / "run")
