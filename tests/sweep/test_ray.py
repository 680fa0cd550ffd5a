"""Sweeps on a real Ray, in a network namespace of its own: outside of one it listens on every interface."""

import os
import shutil
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pandas as pd
import pytest
from interrupted_runs import ADAM, assert_same_numbers
from slurm import await_that

# The processes in it see no others and are killed with the first of them.
NAMESPACE = ("unshare", "--net", "--pid", "--fork", "--mount-proc", "--kill-child")
LONGER = (*ADAM, "training.iterations=600", "training.history_every=50", "training.checkpoint_every_s=0.5")
LAUNCHER = ("hydra/launcher=ray_local", "hydra.launcher.ray.init.num_cpus=2", "hydra.sweep.dir=sweep")

pytestmark = pytest.mark.slow

Start = Callable[..., "subprocess.Popen[bytes]"]


@pytest.fixture
def start(tmp_path: Path) -> Start:
    """Start a sweep in a namespace of its own; without one the test is skipped, with the reason."""
    pytest.importorskip("ray", reason="not installed: pip install 'pinn-cli[ray]'")
    for program in ("unshare", "ip"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed, and without a network namespace Ray would listen everywhere")
    if subprocess.run([*NAMESPACE, "ip", "link", "set", "lo", "up"], capture_output=True).returncode != 0:
        pytest.skip("this user may not make a network namespace, and without one Ray would listen everywhere")
    # Ray keeps a token and its sockets below the home and the temporary folder.
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "HOME": str(tmp_path)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)

    def call(*arguments: str) -> subprocess.Popen[bytes]:
        program = [sys.executable, "-m", "pinn_cli.main", "--multirun", *arguments]
        inside = ["bash", "-c", 'ip link set lo up && exec "$@"', "bash", *program]
        with (tmp_path / "launcher.txt").open("a") as output:
            return subprocess.Popen([*NAMESPACE, *inside], env=environment, cwd=tmp_path, stdout=output, stderr=output)

    return call


def workers(launcher: subprocess.Popen[bytes]) -> list[int]:
    """Processes of Ray that run a job, in the namespace of that launcher."""
    network = Path(f"/proc/{launcher.pid}/ns/net").readlink()

    def is_one(process: Path) -> bool:
        with suppress(OSError):  # it has ended meanwhile
            mine = (process / "ns" / "net").readlink() == network
            return mine and (process / "cmdline").read_bytes().startswith(b"ray::_run_job")
        return False

    return [int(process.name) for process in Path("/proc").glob("[0-9]*") if is_one(process)]


def test_jobs_go_on_when_workers_and_the_launcher_are_killed(start: Start, tmp_path: Path) -> None:
    sweep = (*LAUNCHER, *LONGER, "seed=range(6)")
    said = tmp_path / "launcher.txt"
    launcher = start(*sweep)
    try:
        await_that(lambda: len(list(tmp_path.glob("sweep/*/checkpoint.previous.pt"))) >= 2)
        os.kill(workers(launcher)[0], signal.SIGKILL)
        # Ray runs the job again when its turn comes.
        await_that(lambda: "going on from" in "".join(log.read_text() for log in tmp_path.glob("sweep/*/pinn-run.log")))
    finally:
        launcher.kill()
        launcher.wait()
    assert 1 <= len(list(tmp_path.glob("sweep/*/run.json"))) < 6, said.read_text()

    assert start(*sweep).wait() == 0, said.read_text()
    assert "jobs are finished already" in said.read_text()
    table = pd.read_csv(tmp_path / "sweep" / "jobs.csv")
    assert list(table["seed"]) == list(range(6))
    assert set(table["status"]) == {"finished"}
    rows = Counter(pd.read_csv(tmp_path / "sweep" / "fitness.csv")["seed"])
    assert len(set(rows.values())) == 1, rows

    assert start(*LONGER, "seed=range(6)", "hydra.sweep.dir=alone").wait() == 0, said.read_text()
    for job in (tmp_path / "alone").glob("seed=*"):
        assert_same_numbers(job, tmp_path / "sweep" / job.name)


def test_a_job_whose_worker_is_killed_again_and_again_takes_no_other_along(start: Start, tmp_path: Path) -> None:
    launcher = start(*LAUNCHER, *LONGER, "hydra.launcher.ray.remote.max_retries=0", "seed=0,1")
    await_that(lambda: len(list(tmp_path.glob("sweep/*/checkpoint.previous.pt"))) == 2)
    os.kill(workers(launcher)[0], signal.SIGKILL)
    assert launcher.wait() == 1, (tmp_path / "launcher.txt").read_text()
    table = pd.read_csv(tmp_path / "sweep" / "jobs.csv", keep_default_na=False)
    assert sorted(table["status"]) == ["failed", "finished"]
    assert table["reason"].str.contains("Ray: WorkerCrashedError").any()
