"""A SLURM for tests: the user's own if one answers, else one of this machine alone, started and stopped by a script."""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

# Not part of this repository: a single-node SLURM on 127.0.0.1 for whoever has it beside the checkout.
SCRIPT = Path(__file__).parents[2] / "shared" / "tools" / "slurm_localhost.sh"
CPUS = 4


@contextmanager
def slurm() -> Iterator[dict[str, str]]:
    """The environment to call it with; skips the test, saying why, where there is none."""
    pytest.importorskip("submitit", reason="not installed: pip install 'pinn-cli[slurm]'")
    # Bytecode is kept where it may be: every job starts a Python of its own.
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    if _answers(environment):
        yield environment
        return
    for program in ("slurmctld", "slurmd", "slurmdbd", "munged", "mariadbd"):
        if shutil.which(program, path=f"{os.environ['PATH']}:/usr/sbin:/sbin") is None:
            pytest.skip(f"no SLURM answers sinfo, and {program} is not installed to start one")
    if not SCRIPT.is_file():
        pytest.skip(f"no SLURM answers sinfo, and there is no {SCRIPT.name} to start one")
    # Not below pytest's folder, which is closed to others: munge refuses a socket there.
    place = Path(tempfile.mkdtemp(prefix="pinn_run_slurm_"))
    place.chmod(0o755)
    port = str(20000 + 4 * (os.getpid() % 3000))
    own = {"SLURM_LOCALHOST_DIR": str(place), "SLURM_LOCALHOST_PORT": port, "SLURM_LOCALHOST_CPUS": str(CPUS)}
    environment.update(own, SLURM_CONF=str(place / "slurm.conf"))
    try:
        started = subprocess.run([SCRIPT, "start"], env=environment, capture_output=True, text=True)
        assert started.returncode == 0, started.stdout + started.stderr
        yield environment
    finally:
        subprocess.run([SCRIPT, "stop"], env=environment, check=True)
        shutil.rmtree(place, ignore_errors=True)


def _answers(environment: dict[str, str]) -> bool:
    if shutil.which("sinfo") is None:
        return False
    return subprocess.run(["sinfo", "-h"], env=environment, capture_output=True, timeout=60).returncode == 0


class Cluster:
    """Calls of SLURM's commands and of `pinn-run` in one folder."""

    def __init__(self, environment: dict[str, str], folder: Path) -> None:
        self.environment, self.folder = environment, folder

    def call(self, *command: str) -> str:
        done = subprocess.run(command, env=self.environment, cwd=self.folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        """A launcher, which goes on beside the test."""
        program = [sys.executable, "-m", "pinn_cli.main", "--multirun", *arguments]
        with (self.folder / "launcher.txt").open("a") as output:
            return subprocess.Popen(
                program, env=self.environment, cwd=self.folder, stdout=output, stderr=output, text=True
            )

    def said(self) -> str:
        """All that the launchers printed."""
        return (self.folder / "launcher.txt").read_text()

    def sweep(self, *arguments: str) -> int:
        """The exit status of a launcher that is left alone."""
        return self.start(*arguments).wait()

    def tasks(self, state: str = "all") -> list[str]:
        """Those that are queued or run, as `17_3`."""
        listed = self.call("squeue", "--noheader", "--array", "--format=%i %T").splitlines()
        return [line.split()[0] for line in listed if state in ("all", line.split()[1])]


def await_that(condition: Callable[[], bool], seconds: float = 300.0) -> None:
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, "waited in vain"
        time.sleep(0.1)
