"""Jobs in processes of their own or sent elsewhere, and what a user is told who has not what a launcher needs."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
from calls import SMALL, PinnRun
from hydra.core.utils import JobReturn
from interrupted_runs import run_in_a_child
from sweeps import start

from pinn_cli.runs.process import usable_cores
from pinn_cli.sweep.launching import QUIET_END, JoblibLauncher, SerialLauncher, pin, shares


@pytest.mark.parametrize(
    ("preset", "extra", "package"),
    [("slurm", "slurm", "submitit"), ("workstation", "slurm", "submitit"), ("ray_local", "ray", "ray")],
)
def test_a_preset_whose_package_is_missing_names_the_extra(preset, extra, package, pinn_run, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    for module in ("submitit_launcher", "ray_launcher"):
        monkeypatch.delitem(sys.modules, f"pinn_cli.sweep.{module}", raising=False)
    done = pinn_run("--multirun", f"hydra/launcher={preset}", *SMALL, "seed=0,1").refused()
    assert done.err == (
        f"pinn-run: hydra/launcher={preset}: must be an installed launcher; pip install 'pinn-cli[{extra}]'\n"
    )
    assert not list(Path().iterdir())


@pytest.mark.parametrize("setting", ["hydra.launcher.x=1", "+hydra.launcher.x=1", "hydra.sweeper.x=1"])
def test_a_setting_that_a_launcher_or_a_sweeper_has_not_is_told_in_one_line(setting: str, pinn_run: PinnRun) -> None:
    pinn_run("--multirun", *SMALL, "seed=0,1", setting).refused(setting)
    assert not list(Path().iterdir())


def test_a_ray_cluster_that_is_not_there_is_told_in_one_line(pinn_run: PinnRun, monkeypatch):
    ray = pytest.importorskip("ray", reason="not installed: pip install 'pinn-cli[ray]'")

    def refuse(**settings: object) -> None:
        raise ConnectionError("Could not find any running Ray instance.")

    monkeypatch.setattr(ray, "init", refuse)
    done = pinn_run("--multirun", "hydra/launcher=ray_cluster", *SMALL, "seed=0,1", "hydra.sweep.dir=sweep").refused()
    assert done.err == (
        "pinn-run: hydra.launcher.ray.init.address=auto: must be that of a Ray cluster; "
        "Could not find any running Ray instance.\n"
    )
    assert not Path("sweep").exists()


@pytest.mark.slow
def test_a_finished_trial_of_a_search_returns_its_score_and_is_not_run_again(pinn_run, tmp_path, monkeypatch):
    """Without its score the search would take it for failed."""
    sweep = ("--multirun", *SMALL, "scheme.unobserved_fraction=0.3", "hydra.sweep.dir=sweep", "seed=0,1")
    sweep += ("validation=heldout", "validation.dofs=[1]")
    pinn_run(*sweep).done()
    returned: list[JobReturn] = []
    launch = SerialLauncher.launch

    def noted(launcher, job_overrides, initial_job_idx):
        returned.extend(launch(launcher, job_overrides, initial_job_idx))
        return returned

    monkeypatch.setattr(SerialLauncher, "launch", noted)
    monkeypatch.setattr(SerialLauncher, "run", lambda *_: pytest.fail("they are finished"))
    assert pinn_run(*sweep).status == 0
    kept = [json.loads(file.read_text()) for file in sorted((tmp_path / "sweep").glob("seed=*/run.json"))]
    assert [result.return_value for result in returned] == [run["validation"]["score"] for run in kept]


# Two jobs that finish and one that cannot; Adam is trained in steps and so has checkpoints.
SWEEP = ("--multirun", *SMALL, "hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "seed=0,1", "hydra.sweep.dir=sweep")


# Loaded by every process of the sweep: the one that simulates the record of seed 1 is killed, whenever it tries.
KILLS_ITS_WORKER = """
import os, signal
import pinn_cli.cli.config
read = pinn_cli.cli.config.RunConfig.read.__func__
def killed(cls, config, *others):
    if config.seed == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return read(cls, config, *others)
pinn_cli.cli.config.RunConfig.read = classmethod(killed)
"""


def test_workers_do_what_one_process_does(tmp_path: Path) -> None:
    process = start(tmp_path, *SWEEP, "seed=1", "system.m=1,-1")
    out, err = process.communicate(timeout=300)
    assert process.returncode == 2, err
    assert "2 jobs: 1 finished, 1 failed" in out
    assert err.count(" of 2  ") == 2
    fitness = pd.read_csv(tmp_path / "sweep" / "fitness.csv")
    assert fitness.loc[fitness["status"] == "finished", "seed"].drop_duplicates().tolist() == [1]
    assert fitness.loc[fitness["status"] == "failed", "reason"].str.contains("m=-1").sum() == 1
    assert not list((tmp_path / "sweep").rglob("response.png"))
    run_in_a_child(tmp_path / "one", *SMALL, "seed=1", "system.m=1", "figures=false")
    (job,) = (tmp_path / "sweep").glob("*system.m=1_*")
    for name in ("fitness.csv", "parameters.csv", "free_run.csv"):
        assert (tmp_path / "one" / name).read_bytes() == (job / name).read_bytes()


@pytest.mark.slow
def test_ctrl_c_ends_all_and_the_same_command_goes_on(tmp_path: Path) -> None:
    adam = (*SWEEP, "network=mlp", "network.width=16", "training=adam", "training.iterations=400")
    whole = start(tmp_path, *adam, "hydra.sweep.dir=whole")
    assert whole.communicate(timeout=300) is not None
    process = start(tmp_path, *adam, "training.checkpoint_every_s=0.2")
    while not list((tmp_path / "sweep").glob("*/checkpoint.pt")):
        assert process.poll() is None
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "to go on: the same command again; for what there is: pinn-run collect=sweep\n" in err
    assert "Traceback" not in err
    again = start(tmp_path, *adam)
    out, err = again.communicate(timeout=300)
    assert again.returncode == 0, err
    assert "2 jobs: 2 finished" in out
    for name in ("fitness.csv", "parameters.csv", "summary.csv"):
        assert (tmp_path / "sweep" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


@pytest.mark.parametrize("launcher", ["joblib", "workstation"])
@pytest.mark.slow
def test_workers_import_nothing_from_the_current_folder(launcher: str, tmp_path: Path) -> None:
    if launcher == "workstation":
        pytest.importorskip("submitit", reason="not installed: pip install 'pinn-cli[slurm]'")
    for module in ("numpy", "yaml", "torch"):
        (tmp_path / f"{module}.py").write_text("import pathlib\npathlib.Path('executed').touch()\n")
    overrides = (*SMALL, f"hydra/launcher={launcher}", "seed=0,1", "figures=false")
    command = [sys.executable, "-P", "-m", "pinn_cli.main", "--multirun", *overrides]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=500)
    assert not (tmp_path / "executed").exists()
    assert done.returncode == 0, done.stderr
    assert "2 jobs: 2 finished" in done.stdout


def test_what_workers_leave_behind_is_taken_away_in_silence() -> None:
    text = "import warnings; warnings.warn('resource_tracker: There appear to be 3 leaked semlock objects')"
    for environment, told in (({}, True), (QUIET_END, False)):
        done = subprocess.run(
            [sys.executable, "-c", text], env=os.environ | environment, capture_output=True, text=True
        )
        assert bool(done.stderr) == told


def test_a_lone_worker_has_no_limit_of_time(capfd: pytest.CaptureFixture[str]) -> None:
    launcher = JoblibLauncher(SimpleNamespace(config={"threads": 1}), n_jobs=1, timeout=1.5)
    assert launcher.settings["timeout"] is None
    assert capfd.readouterr().err.startswith("pinn-run: hydra.launcher.timeout ")


@pytest.mark.slow
def test_a_killed_worker_takes_only_its_own_job_along(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(KILLS_ITS_WORKER)
    process = start(tmp_path, *SWEEP, "seed=0,1,2,3", env={"PYTHONPATH": str(tmp_path)})
    out, err = process.communicate(timeout=300)
    assert process.returncode == 1, err
    assert "4 jobs: 3 finished, 1 failed" in out
    assert "its worker was killed" in out
    jobs = pd.read_csv(tmp_path / "sweep" / "jobs.csv").set_index("seed")
    assert jobs["status"].to_dict() == {0: "finished", 1: "failed", 2: "finished", 3: "finished"}


def _pinned(barrier: object, results: object) -> None:
    pin(2)
    cores = usable_cores()
    pin(2)
    barrier.wait(60)  # type: ignore[attr-defined]
    results.put((cores, usable_cores()))  # type: ignore[attr-defined]


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system does not pin processes")
@pytest.mark.skipif(len(usable_cores()) < 2, reason="there is one core")
def test_siblings_have_different_cores() -> None:
    context = multiprocessing.get_context("fork")
    barrier, results = context.Barrier(2), context.Queue()
    processes = [context.Process(target=_pinned, args=(barrier, results)) for _ in range(2)]
    for process in processes:
        process.start()
    (one, one_again), (other, other_again) = (results.get(timeout=60) for _ in processes)
    for process in processes:
        process.join()
    assert (one, other) == (one_again, other_again)
    assert not set(one) & set(other)
    assert sorted(one + other) == usable_cores()
    assert shares([0, 1, 5], 2) == [[0], [1, 5]]
    assert shares([4, 7], 3) == [[4], [7], [4]]
