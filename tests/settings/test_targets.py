"""A configuration chooses registered classes, each at its place, and runs nothing else."""

import sys
from pathlib import Path

import pytest
from calls import refusal, register
from omegaconf import DictConfig, OmegaConf

from pinn_cli.settings import instantiation
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.instantiation import build, check_classes
from pinn_cli.system.connection.duffing import Duffing
from pinn_cli.system.connection.power_damping import PowerDamping

DUFFING = "pinn_cli.system.connection.duffing.Duffing"
PLUGIN = "package_of_one_s_own.mine.Mine"


def node(**entries: object) -> DictConfig:
    return OmegaConf.create(entries)


@pytest.mark.parametrize(
    "target",
    [
        "os.system",
        "builtins.eval",
        "pinn_cli_evil.Class",
        "pinn_cli.runs.claim.shutil.rmtree",
        "pinn_cli.network.mlp.Mlp",  # ours, at another place
        DUFFING.lower(),
        f" {DUFFING}",
        "torch.load",
        PLUGIN,
        5,
        ["a"],
        None,
    ],
)
def test_other_targets_are_refused(target: object, tmp_path: Path) -> None:
    before = set(sys.modules)
    with pytest.raises(InputError, match=r"data\._target_"):
        build(node(_target_=target, path=str(tmp_path)), "data")
    assert set(sys.modules) == before
    assert tmp_path.is_dir()


def test_targets_are_checked_to_the_leaves_and_then_built() -> None:
    config = node(network=node(layers=[node(activation=node(_target_="os.system", command="true"))]))
    with pytest.raises(InputError, match=r"network.layers\[0\].activation._target_=os.system"):
        check_classes(config)
    with pytest.raises(InputError, match=r"noise._target_=os.system: must be left out"):
        check_classes(node(noise=node(_target_="os.system")))
    assert isinstance(build(node(_target_=DUFFING), "system.nonlinearity", base="not taken"), Duffing)
    target = "pinn_cli.system.connection.power_damping.PowerDamping"
    built = build(node(_target_=target, exponent=1.5), "system.nonlinearity")
    assert isinstance(built, PowerDamping)
    assert built.exponent == 1.5
    target = "pinn_cli.record.excitation.impulse.Impulse"
    with pytest.raises(InputError, match=r"excitation.strt=3: .*excitation.start.*did you mean start"):
        build(node(_target_=target, strt=3), "excitation", ndof=1, duration=1.0, samples=16)


def test_what_is_shipped_is_what_the_files_say() -> None:
    conf = Path(__file__).parents[2] / "conf"

    def targets(content: object) -> set[str]:
        if not isinstance(content, dict):
            return set()
        own = {content["_target_"]} if "_target_" in content else set()
        return own.union(*map(targets, content.values()))

    for file in conf.rglob("*.yaml"):
        found = targets(OmegaConf.to_container(OmegaConf.load(file), resolve=False))
        place = ".".join(file.parent.relative_to(conf).parts) or "hydra.callbacks"
        assert found <= instantiation.shipped().get(place, set()), file
    assert all(target.startswith(("pinn_cli.", "hydra_plugins.pinn_run.")) for target in
               set().union(*instantiation.shipped().values()))  # fmt: skip


def test_an_installed_package_registers_its_classes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "package_of_one_s_own"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "mine.py").write_text("class Mine:\n    def __init__(self, size=1):\n        self.size = size\n")
    register(tmp_path, "of_one_s_own", "network.mine = package_of_one_s_own.mine:Mine\nnowhere = os:system")
    monkeypatch.syspath_prepend(tmp_path)
    check_classes(node(network=node(_target_=PLUGIN)))
    assert "package_of_one_s_own" not in sys.modules
    assert build(node(_target_=PLUGIN, size=3), "network").size == 3
    for place in ("training", "noise", "nowhere"):
        with pytest.raises(InputError, match=f"{place}._target_={PLUGIN}"):
            build(node(_target_=PLUGIN), place)


@pytest.mark.parametrize(
    ("target", "told"),
    [
        ("pinn_cli.system.connection.duffin.Duffing", f"did you mean {DUFFING}?"),
        ("pinn_cli.system.connection.duffing.Duffin", f"did you mean {DUFFING}?"),
        ("my_package.MyLaw", "entry point system.NAME of pinn_cli.plugins"),
    ],
)
def test_misspelt_targets_are_told(target: str, told: str) -> None:
    assert told in refusal(build, node(_target_=target), "system.nonlinearity")
