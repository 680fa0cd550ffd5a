"""`make stored`: the archive of the release that is installed, `tests/stored/VERSION.zip`, made once and kept."""

import os
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path
from typing import Any
from unittest.mock import patch

from interrupted_runs import ADAM

from pinn_cli.cli.command_line import execute
from pinn_cli.main import run
from pinn_cli.runs.identity import package_version
from pinn_cli.sweep.window_store import WindowStore
from pinn_cli.training.gradient.training import Descent

TINY = (
    "system.ndof=2", "simulation.duration=8", "simulation.samples=128", "excitation.band=[0.2,1.5]", "threads=1",
    "figures=false",
)  # fmt: skip
SWEEP = (*TINY, "seed=0,1", "hydra.sweep.dir=sweep")
SEARCH = (
    *TINY, "hydra/sweeper=search", "validation=forecast", "hydra.sweep.dir=search",
    "network.knots_per_period=interval(1.0,5.0)",
)  # fmt: skip
RUNS = {
    "sparse_recovery": (*TINY, "scheme.unobserved=[2]"),
    "state_parameter": (*TINY, "scheme=state_parameter", "scheme.unobserved=[]", "scheme.unknown=[k_2]"),
    "bayesian": (
        *TINY, "scheme=bayesian", "scheme.unobserved=[]", "posterior.chains=2", "posterior.warmup=20",
        "posterior.draws=20",
    ),
}  # fmt: skip
# Stopped on their way: by the class and the method that is stopped, after so many calls.
STOPPED: dict[str, tuple[tuple[str, ...], Any, str, int]] = {
    "mlp": ((*ADAM, *TINY), Descent, "step", 10),
    "windows": ((*TINY, "simulation.duration=24", "simulation.samples=384", "data.window=8", "data.overlap=2"),
                WindowStore, "conclude", 1),
}  # fmt: skip


def pinn_run(*arguments: str) -> int:
    """The exit status of the command in this process."""
    with patch.object(sys, "argv", ["pinn-run", *arguments]):
        return execute(run)


def stopped_after(calls: int, method: Callable[..., Any]) -> Callable[..., Any]:
    """The same, as if Ctrl-C were pressed when it has returned for the last of so many times."""
    left = [calls]

    def call(*given: Any, **named: Any) -> Any:
        returned = method(*given, **named)
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt
        return returned

    return call


def make() -> None:
    """All of them, in the current folder."""
    for name, overrides in RUNS.items():
        assert pinn_run(*overrides, f"hydra.run.dir={name}") == 0, name
    for name, (overrides, owner, method, calls) in STOPPED.items():
        with patch.object(owner, method, stopped_after(calls, getattr(owner, method))):
            assert pinn_run(*overrides, f"hydra.run.dir={name}") == 130, name
    assert pinn_run("--multirun", *SWEEP) == 0
    (one,) = Path("sweep").glob("seed=1_*")  # the job that is missing when the sweep goes on
    shutil.rmtree(one)
    assert pinn_run("--multirun", *SEARCH, "hydra.sweeper.n_trials=2") == 0


def is_left_out(file: Path) -> bool:
    """What is large and never read back."""
    return file.suffix in (".png", ".pdf") or (file.name == "response.nc" and file.parts[0] == "search")


def main() -> None:
    """Make them, and put them into the archive."""
    archive = Path(__file__).with_name(f"{package_version('pinn-cli')}.zip")
    if archive.exists():
        sys.exit(f"{archive} is there: what a release wrote does not change")
    with tempfile.TemporaryDirectory(prefix="pinn-run-stored-") as folder, chdir(folder):
        make()
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as content:
            for file in sorted(path for path in Path().rglob("*") if path.is_file() and not is_left_out(path)):
                content.write(file)
    print(f"{archive}: {os.path.getsize(archive) / 1024:.0f} kB")


if __name__ == "__main__":
    main()
