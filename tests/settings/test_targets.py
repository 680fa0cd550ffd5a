"""A configuration chooses classes of this package and of torch, and runs nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from omegaconf import DictConfig, OmegaConf

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.instantiation import build, check_classes
from pinn_cli.system.connection.duffing import Duffing
from pinn_cli.system.connection.power_damping import PowerDamping


def node(**entries: object) -> DictConfig:
    return OmegaConf.create(entries)


@pytest.mark.parametrize(
    "target",
    [
        "os.system",
        "subprocess.run",
        "builtins.eval",
        "pinn_cli",
        "pinn_cli_evil.Class",
        "pinn_cli.runs.directories.shutil.rmtree",  # begins well, but is another package's function
        "pinn_cli.runs.directories.Path",  # another package's class, imported here
        "pinn_cli.runs.directories.discard",  # a function
        "torch.load",
        "torch.hub.load",
        "torch.os.system",
        "",
        5,
    ],
)
def test_other_targets_are_refused(target: object, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="_target_"):
        build(node(_target_=target, path=str(tmp_path)), "data")
    assert tmp_path.is_dir()


def test_targets_are_checked_to_the_leaves_before_anything_is_built() -> None:
    config = node(network=node(layers=[node(activation=node(_target_="os.system", command="true"))]))
    with pytest.raises(InputError, match=r"network.layers\[0\].activation._target_=os.system"):
        check_classes(config)


def test_build_of_our_classes_and_torch_s() -> None:
    assert isinstance(build(node(_target_="torch.nn.SiLU"), "activation"), torch.nn.SiLU)
    assert isinstance(build(node(_target_="pinn_cli.system.connection.duffing.Duffing"), "n"), Duffing)
    built = build(node(_target_="pinn_cli.system.connection.power_damping.PowerDamping", exponent=1.5), "n")
    assert isinstance(built, PowerDamping)
    assert built.exponent == 1.5


@pytest.mark.parametrize(
    ("target", "told"),
    [
        ("pinn_cli.system.connection.duffin.Duffing", "did you mean pinn_cli.system.connection.duffing?"),
        ("pinn_cli.system.connection.duffing.Duffin", "did you mean Duffing?"),
        ("pinn_cli.sistem.Duffing", "existing class"),
    ],
)
def test_misspelt_targets_are_told(target: str, told: str) -> None:
    with pytest.raises(InputError) as error:
        build(node(_target_=target), "system.nonlinearity")
    assert told in str(error.value)


def test_entries_are_compared_with_the_signature() -> None:
    target = "pinn_cli.record.simulation.Simulation"
    with pytest.raises(InputError, match=r"simulation.duraton=3: .*simulation.duration.*did you mean duration"):
        build(node(_target_=target, duraton=3, samples=64), "simulation")
    with pytest.raises(InputError, match=r"simulation.samples=\(missing\)"):
        build(node(_target_=target, duration=3.0), "simulation")


def test_arguments_that_a_class_does_not_take_are_left_out() -> None:
    assert build(node(_target_="pinn_cli.system.connection.duffing.Duffing"), "n", base="unused").name == "duffing"
