"""A disk that takes no more, and paths that are none: one line, nothing half-written, and the run goes on later."""

import os
import subprocess
import sys
import traceback
from pathlib import Path

import pytest
from calls import SMALL, PinnRun, limit_files
from interrupted_runs import ADAM, assert_same_numbers, contents, run_in_a_child, without_figures

from pinn_cli.cli.command_line import execute
from pinn_cli.main import run
from pinn_cli.report import figures

# Of a file, bytes: a checkpoint is larger, and so is response.nc, the settings and the lock are smaller.
SMALLEST, LARGER = 16_000, 40_000


def limited(size: int, *arguments: str) -> tuple[int, str]:
    """Status and errors of a run whose files the system lets grow no larger, as on a disk that has become full."""
    out, into = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            figures.write_figures = lambda *args, **kwargs: None
            limit_files(size)
            sys.argv = ["pinn-run", *arguments]
            sys.stderr = os.fdopen(into, "w", buffering=1)
            os._exit(execute(run))
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(99)
    os.close(into)
    with os.fdopen(out) as told:
        text = told.read()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), text


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_in_a_child(tmp_path_factory.mktemp("undisturbed") / "whole", *ADAM)


@pytest.mark.parametrize("size", [SMALLEST, pytest.param(LARGER, marks=pytest.mark.slow)])
def test_a_full_disk_in_mid_run(pinn_run: PinnRun, whole: Path, tmp_path: Path, monkeypatch, size: int) -> None:
    """In a checkpoint, and in response.nc."""
    monkeypatch.chdir(tmp_path)
    command = (*ADAM, "hydra.run.dir=run", "resume=auto")
    status, told = limited(size, *command)
    assert (status, told.count("\n"), told.endswith("pinn-run resume=run\n")) == (3, 1, True), told
    assert "cannot be written: File too large; " in told
    assert not list(tmp_path.rglob("*.partial*"))
    assert not (tmp_path / "run" / "run.json").exists()
    without_figures(monkeypatch)
    pinn_run(*command).done()
    assert_same_numbers(whole, tmp_path / "run")


def test_a_disk_that_is_full_from_the_start(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    status, told = limited(0, *ADAM, "hydra.run.dir=deep/run")
    assert (status, told.count("\n")) == (2, 1), told
    assert "hydra.run.dir=" in told
    assert not list(tmp_path.iterdir())


PLACES = {
    "a file above": (lambda: Path("outputs").touch(), ("seed=0",)),
    "a file": (lambda: Path("run").touch(), ("hydra.run.dir=run",)),
    "a FIFO": (lambda: os.mkfifo("run"), ("hydra.run.dir=run",)),
    "a name too long": (lambda: None, (f"case={'x' * 300}",)),
    "a path too long": (lambda: None, (f"hydra.run.dir={'/'.join(['x' * 200] * 30)}",)),
    "a file above a sweep": (lambda: Path("outputs").touch(), ("--multirun", "seed=0,1")),
    "a sweep's name too long": (lambda: None, ("--multirun", "seed=0,1", f"hydra.sweep.dir={'x' * 300}")),
    "a job's name too long": (lambda: None, ("--multirun", "seed=0,1", f"hydra.sweep.subdir={'x' * 300}")),
    "a FIFO to go on with": (lambda: os.mkfifo("run"), ("resume=run",)),
    "a link to nowhere": (lambda: Path("run").symlink_to("nowhere"), ("hydra.run.dir=run",)),
    "no directory to write in": (lambda: None, ("hydra.run.dir=/proc/run",)),
    "nothing to collect": (lambda: os.mkfifo("run"), ("collect=run",)),
}


@pytest.mark.parametrize(("make", "given"), PLACES.values(), ids=PLACES.keys())
def test_places_that_are_none(pinn_run: PinnRun, tmp_path: Path, make, given: tuple[str, ...]) -> None:
    make()
    before = sorted(tmp_path.rglob("*"))
    outcome = pinn_run(*SMALL, *given) if "=run" not in given[-1] or "hydra" in given[-1] else pinn_run(*given)
    assert (outcome.status, outcome.err.count("\n")) == (2, 1), outcome.err
    assert "dir=" in outcome.err or "resume=" in outcome.err or "collect=" in outcome.err
    assert sorted(tmp_path.rglob("*")) == before


def test_a_directory_that_cannot_be_written_to(pinn_run: PinnRun, tmp_path: Path, monkeypatch) -> None:
    """Mounted read-only, since root may write where others may not."""
    without_figures(monkeypatch)
    assert pinn_run(*ADAM, "training.iterations=1", "hydra.run.dir=run").status == 0
    (tmp_path / "run" / "run.json").unlink()
    before = contents(tmp_path)
    mounted = subprocess.run(["mount", "--bind", "-o", "ro", "run", "run"], cwd=tmp_path, capture_output=True)
    if mounted.returncode:
        pytest.skip("only root may mount")
    try:
        for given in (("resume=run",), (*ADAM, "hydra.run.dir=run"), (*ADAM, "hydra.run.dir=run/new")):
            pinn_run(*given).refused("Read-only file system")
    finally:
        subprocess.run(["umount", "run"], cwd=tmp_path, check=True)
    assert contents(tmp_path) == before


def test_output_that_nobody_can_take(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pinn_cli.main", "--cfg", "job"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr.count("\n")) == (3, 1), done.stderr
    assert "No space left on device" in done.stderr
