"""Launchers of plugins: ours in their place, jobs that are lost, and what a user is told who has not the plugin."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import pytest
from calls import SMALL, PinnRun
from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn
from hydra.errors import MissingConfigException

from pinn_cli.cli.override_errors import explain
from pinn_cli.sweep.launched import to_launch

INSTALLED = Plugins.instance().class_name_to_class


@pytest.mark.parametrize(("preset", "extra"), [("slurm", "slurm"), ("workstation", "slurm"), ("ray_local", "ray")])
def test_a_preset_whose_plugin_is_missing_names_the_extra(preset: str, extra: str, pinn_run: PinnRun, monkeypatch):
    for name in [name for name in INSTALLED if "submitit" in name or "ray" in name]:
        monkeypatch.delitem(INSTALLED, name)
    done = pinn_run("--multirun", f"hydra/launcher={preset}", *SMALL, "seed=0,1")
    assert done.status == 2
    assert done.err == (
        f"pinn-run: hydra/launcher={preset}: must be an installed launcher; pip install 'pinn-cli[{extra}]'\n"
    )
    assert not list(Path().iterdir())


@pytest.mark.parametrize(
    ("option", "extra"), [("submitit_slurm", "slurm"), ("submitit_local", "slurm"), ("ray", "ray")]
)
def test_so_does_an_option_of_the_plugin_itself(option: str, extra: str):
    missing = MissingConfigException("", missing_cfg_file=f"hydra/launcher/{option}")
    told = explain(missing, [f"hydra/launcher={option}"], None, composing=True)
    assert str(told) == f"hydra/launcher={option}: must be an installed launcher; pip install 'pinn-cli[{extra}]'"


def test_a_ray_cluster_that_is_not_there_is_told_in_one_line(pinn_run: PinnRun, monkeypatch):
    pytest.importorskip("hydra_plugins.hydra_ray_launcher", reason="not installed: pip install 'pinn-cli[ray]'")
    util = importlib.import_module("hydra_plugins.hydra_ray_launcher._launcher_util")

    def refuse(settings: object) -> None:
        raise ConnectionError("Could not find any running Ray instance.")

    monkeypatch.setattr(util, "start_ray", refuse)
    done = pinn_run("--multirun", "hydra/launcher=ray_cluster", *SMALL, "seed=0,1", "hydra.sweep.dir=sweep")
    assert done.status == 2
    assert done.err == (
        "pinn-run: hydra.launcher.ray.init.address=auto: must be that of a Ray cluster; "
        "Could not find any running Ray instance.\n"
    )
    assert not Path("sweep").exists()


def test_a_finished_trial_of_a_search_returns_its_score(pinn_run: PinnRun, tmp_path: Path, monkeypatch) -> None:
    """It is sent nowhere by the launchers of SLURM and Ray: without its score the search would take it for failed."""
    sweep = ("--multirun", *SMALL, "scheme.unobserved_fraction=0.3", "hydra.sweep.dir=sweep", "seed=0,1")
    sweep += ("validation=heldout", "validation.dofs=[1]")
    done = pinn_run(*sweep)
    assert done.status == 0, done.err
    scores: list[JobReturn] = []

    def launch(launcher, job_overrides, initial_job_idx):
        left, found = to_launch(launcher, job_overrides, initial_job_idx)
        assert not left
        scores.extend(found.values())
        return list(found.values())

    monkeypatch.setattr(INSTALLED["hydra._internal.core_plugins.basic_launcher.BasicLauncher"], "launch", launch)
    assert pinn_run(*sweep).status == 0
    kept = [json.loads(file.read_text()) for file in sorted((tmp_path / "sweep").glob("seed=*/run.json"))]
    assert [result.return_value for result in scores] == [run["validation"]["score"] for run in kept]
