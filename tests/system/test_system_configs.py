from pathlib import Path

import pytest
from omegaconf import OmegaConf

from pinn_cli.settings.instantiation import build, construct
from pinn_cli.system import build_chain

CONF = Path(__file__).parents[2] / "conf"


@pytest.mark.parametrize(
    "name", ["duffing", "van_der_pol", "linear", "power_damping", "polynomial", "friction", "jenkins"]
)
def test_every_system_config_builds_its_chain(name):
    values = OmegaConf.load(CONF / "demonstration" / f"simulated_{name}.yaml")
    structure = construct(
        build_chain, OmegaConf.merge(OmegaConf.load(CONF / "system" / f"{name}.yaml"), values), "system"
    )
    assert structure.nonlinearity_name == name
    paper = {
        "m": 10.0,
        "c": 1.0,
        "k": 15.0,
        "kappa": 100.0,
        "mu": 0.75,
        "k_2": 20.0,
        "k_3": 100.0,
        "F_c": 0.1,
        "k_t": 30.0,
    }
    for parameter, value in structure.parameters.items():
        assert value.tolist() == [paper[parameter]] * 6


@pytest.mark.parametrize("name", ["none", "linear", "perturbed"])
def test_every_model_error_config_is_its_class(name):
    assert build(OmegaConf.load(CONF / "model_error" / f"{name}.yaml"), "model_error").name == name
