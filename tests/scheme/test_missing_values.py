"""Of a measured structure the user gives every value, or says that it is unknown; nothing is a demonstration's."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import Compose, PinnRun, refusal
from omegaconf import DictConfig
from small_problems import measured, small_chain

from pinn_cli.cli.config import RunConfig
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import InputError

CSV = (
    "data=csv",
    "data.path=rig.csv",
    "++data.force={1: f}",
    "++data.displacement={1: u1, 2: u2}",
    "++data.acceleration={1: a1, 2: a2}",
)
DUFFING = ("system.ndof=2", "system.m=10", "system.c=1", "system.k=15", "system.kappa=100")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a record of a structure that has two DOFs, all sensors and one force."""
    where = tmp_path_factory.mktemp("rig")
    record = measured(small_chain(ndof=2)).record
    columns = {"t": record.time, "f": record.force[:, 0]}
    for dof in (1, 2):
        columns[f"u{dof}"] = record.displacement[:, dof - 1]
        columns[f"a{dof}"] = record.acceleration[:, dof - 1]
    pd.DataFrame(columns).to_csv(where / "rig.csv", index=False)
    return where


def posed(composition: DictConfig, folder: Path) -> Problem:
    config = RunConfig.read(composition, folder)
    record = config.observe(config.source.measure(config.structure).record)
    return config.scheme.pose(config.structure, [record]).alone


REFUSED = {
    ("system=duffing", "system.m=2", "system.k=3"): "system.c, system.kappa=(nothing)",
    ("scheme=state_parameter", "scheme.unknown=k_*", "system=linear", "system.m=2"): "system.c=(nothing)",
    ("scheme=state_parameter", "scheme.unknown=k_1", "system=linear", "system.m=2", "system.c=1"): "If k_2 are",
    ("scheme=bayesian",): "system.m=(nothing)",
}


@pytest.mark.parametrize(("overrides", "told"), REFUSED.items(), ids=map(" ".join, REFUSED))
def test_a_value_that_nobody_gave_is_asked_for(composed: Compose, folder: Path, overrides, told):
    message = refusal(posed, composed(*CSV, "system.ndof=2", *overrides), folder)
    assert told in message
    assert "scheme.unknown" in message


@pytest.mark.parametrize(
    "overrides",
    [
        DUFFING,
        ("scheme=state_parameter", "scheme.unknown=[k_*, 'kappa_*']", *DUFFING[:3]),
        ("scheme=state_parameter", "scheme.unknown=[k_*, c_*]", "system=linear", "system.ndof=2", "system.m=10"),
        ("scheme=state_parameter", "scheme.unknown=k_2", *DUFFING[:3], "system.k=[15, null]", "system.kappa=100"),
        ("scheme=bayesian", *DUFFING[:2]),
    ],
    ids=" ".join,
)
def test_what_is_given_or_unknown_makes_a_problem(composed: Compose, folder: Path, overrides):
    problem = posed(composed(*CSV, *overrides), folder)
    assert not problem.record.simulated
    for values in problem.structure.parameters.values():
        assert np.isfinite(values.numpy()).all()


def test_a_simulated_structure_has_every_value(composed: Compose):
    with pytest.raises(InputError, match=r"system\.k=nothing"):
        RunConfig.read(composed("system.k=null"))
    with pytest.raises(InputError, match=r"system\.k=.*every entry"):
        RunConfig.read(composed("system.ndof=2", "system.k=[1,null]"))


EXPERIMENT = """# @package _global_
defaults:
  - override /system: linear
  - override /data: csv
  - _self_
system: {ndof: 2, m: 10.0, c: 1.0, k: 15.0}
data: {path: rig.csv, force: {1: f}, displacement: {1: u1, 2: u2}}
"""
SYSTEM = """ndof: 2
m: 10.0
c: 1.0
k: 15.0
nonlinearity:
  _target_: pinn_cli.system.connection.linear.Linear
"""


def test_values_from_files_of_the_user(pinn_run: PinnRun, folder: Path, tmp_path: Path):
    (tmp_path / "rig.csv").write_text((folder / "rig.csv").read_text())
    for name, text in {"experiment/rig": EXPERIMENT, "system/rig": SYSTEM}.items():
        (tmp_path / "mine" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "mine" / f"{name}.yaml").write_text(text)
    read: list[list[float]] = []

    def task(config: DictConfig) -> None:
        read.append(RunConfig.read(config, tmp_path).structure.parameters["k"].tolist())

    for chosen in (["experiment=rig"], ["system=rig", *CSV], ["--multirun", "experiment=rig", "system.m=9,11"]):
        arguments = [argument.replace("++", "") for argument in chosen]
        assert pinn_run("--config-dir", "mine", *arguments, task=task).status == 0
    assert read == [[15.0, 15.0]] * 4
