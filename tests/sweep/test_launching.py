"""Jobs that launchers send elsewhere, and what a user is told who has not what a launcher needs."""

import json
import sys
from pathlib import Path

import pytest
from calls import SMALL, PinnRun
from hydra.core.utils import JobReturn

from pinn_cli.sweep.launching import SerialLauncher


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
