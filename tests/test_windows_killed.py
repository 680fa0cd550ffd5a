"""SIGKILL of a run by windows and of one that is followed: the same command ends with the same numbers, bit for bit."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import xarray as xr
from storeys import K, record, system, written

# How long each step took is never the same.
TIMED = {"history.csv"}
MODEL = (*system(1.02 * K), "scheme.parameter_uncertainty=0.05", "figures=false", "threads=1")
WINDOWS = ("data.window=4", "data.overlap=1")
PATIENCE = ("follow.poll=0.05", "follow.until_idle=1")


def started(folder: Path, *arguments: str) -> subprocess.Popen[bytes]:
    """The program in a process of its own."""
    nowhere = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen([sys.executable, "-m", "pinn_cli.main", *arguments], cwd=folder, **nowhere)


def killed_after(process: subprocess.Popen[bytes], done: Path, later: float) -> None:
    """SIGKILL so many seconds after a file is there."""
    until = time.monotonic() + 120.0
    while not done.is_file():
        assert process.poll() is None, "it has ended by itself"
        assert time.monotonic() < until, f"{done} does not come"
        time.sleep(0.005)
    time.sleep(later)
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL


def assert_same_numbers(one: Path, other: Path) -> None:
    """Bit for bit."""
    tables = [{file.name for file in place.glob("*.csv")} - TIMED for place in (one, other)]
    assert "parameters.csv" in tables[0]
    assert tables[0] == tables[1]
    for name in tables[0]:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    with xr.open_dataset(one / "response.nc") as first, xr.open_dataset(other / "response.nc") as second:
        assert first.identical(second)
    assert not list(other.rglob("*.partial*"))


@pytest.mark.slow
def test_killed_windows_end_with_the_same_numbers(tmp_path: Path) -> None:
    data = written(record(3, duration=10.02).record, tmp_path / "one.csv")
    command = (*MODEL, *data, *WINDOWS)
    assert started(tmp_path, *command, "hydra.run.dir=whole").wait() == 0
    place = tmp_path / "run" / "windows"
    killed_after(started(tmp_path, *command, "hydra.run.dir=run"), place / "0001" / "window.json", 0.0)
    kept = (place / "0001" / "window.json").stat().st_mtime_ns
    killed_after(started(tmp_path, *command, "hydra.run.dir=run", "resume=auto"), place / "0002" / "window.json", 0.1)
    assert started(tmp_path, *command, "hydra.run.dir=run", "resume=auto").wait() == 0
    assert (place / "0001" / "window.json").stat().st_mtime_ns == kept
    assert_same_numbers(tmp_path / "whole", tmp_path / "run")


@pytest.mark.slow
def test_a_killed_follower_ends_with_the_same_numbers(tmp_path: Path) -> None:
    """Of a file that grows while nobody looks."""
    data = written(record(3, duration=10.02).record, tmp_path / "one.csv")
    lines = (tmp_path / "one.csv").read_text().splitlines(keepends=True)
    undisturbed = (*MODEL, *data, *WINDOWS)
    assert started(tmp_path, *undisturbed, "hydra.run.dir=whole").wait() == 0
    growing = tmp_path / "growing.csv"
    growing.write_text("".join(lines[:260]) + lines[260][:7])
    source = [argument.replace("one.csv", "growing.csv") for argument in data]
    follow = ("follow", *MODEL, *source, *WINDOWS, "hydra.run.dir=run", *PATIENCE)
    place = tmp_path / "run" / "windows"
    # Its second window is what is being waited for, or what had come when nothing more did.
    killed_after(started(tmp_path, *follow[:-1]), place / "0001" / "window.json", 0.3)
    growing.write_text("".join(lines[:400]))
    killed_after(started(tmp_path, *follow[:-1]), place / "0002" / "window.json", 0.0)
    growing.write_text("".join(lines))
    assert started(tmp_path, *follow).wait() == 0
    assert_same_numbers(tmp_path / "whole", tmp_path / "run")
