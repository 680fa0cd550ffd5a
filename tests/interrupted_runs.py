"""Runs that are stopped on their way, and whether two runs came to the same numbers."""

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
import xarray as xr
from calls import SMALL

from pinn_cli.cli.command_line import execute
from pinn_cli.main import run
from pinn_cli.report import figures
from pinn_cli.training.gradient.training import Descent

# 30 steps of Adam on a network of 8 x 8 weights, with a checkpoint at each.
ADAM = (
    *SMALL,
    "network=mlp",
    "training=adam",
    "network.depth=2",
    "network.width=8",
    "training.iterations=15",
    "training.collocation_points=48",
    "training.history_every=7",
    "training.checkpoint_every_s=1e-6",
)


class Steps:
    """The iterations of Adam in this process, of which one may do something besides."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.taken: list[int] = []
        self.happens: dict[int, Callable[[], None]] = {}
        step = Descent.step

        def noted(descent: Descent) -> bool:
            self.taken.append(descent.iteration)
            self.happens.get(descent.iteration, lambda: None)()
            return step(descent)

        monkeypatch.setattr(Descent, "step", noted)

    def signal_at(self, iteration: int, number: int) -> None:
        self.taken.clear()
        self.happens = {iteration: lambda: os.kill(os.getpid(), number)}

    def undisturbed(self) -> None:
        self.taken.clear()
        self.happens = {}


def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """They take longer than all else."""
    monkeypatch.setattr(figures, "write_figures", lambda *args, **kwargs: None)


def assert_same_numbers(one: Path, other: Path) -> None:
    """Bit for bit."""
    for name in ("fitness.csv", "parameters.csv", "free_run.csv"):
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    histories = [pd.read_csv(place / "history.csv", dtype=str).drop(columns="seconds") for place in (one, other)]
    pd.testing.assert_frame_equal(*histories)
    with xr.open_dataset(one / "response.nc") as first, xr.open_dataset(other / "response.nc") as second:
        assert first.identical(second)


def run_in_a_child(directory: Path, *overrides: str) -> Path:
    """A run without figures, in a directory of its own."""

    def call() -> None:
        os.chdir(directory.parent)
        figures.write_figures = lambda *args, **kwargs: None
        sys.argv = ["pinn-run", *overrides, f"hydra.run.dir={directory.name}"]
        execute(run)

    assert in_a_child(call) == 0
    assert (directory / "run.json").is_file()
    return directory


def in_a_child(call: Callable[[], object]) -> int:
    """Do it in a fork of this process, which has imported everything; its exit status, negative for a signal."""
    child = os.fork()
    if child == 0:
        try:
            call()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def gone(process: int) -> bool:
    """Whether a process has ended."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    return False


def contents(directory: Path) -> dict[str, bytes]:
    return {str(file.relative_to(directory)): file.read_bytes() for file in directory.rglob("*") if file.is_file()}
