"""The search spaces of the presets: whatever is drawn from them is a configuration."""

from __future__ import annotations

import pytest
from calls import SMALL, Compose
from hydra import compose, initialize_config_module
from omegaconf import DictConfig

from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.help import option_names

optuna = pytest.importorskip("optuna", reason="the extra optuna is not installed")
PRESETS = [name for name in option_names("experiment") if name.startswith("search/")]


def sweeper_of(preset: str) -> DictConfig:
    with initialize_config_module("pinn_cli.conf", version_base="1.3"):
        return compose("config", overrides=[f"experiment={preset}"], return_hydra_config=True).hydra.sweeper


@pytest.mark.parametrize("preset", PRESETS)
def test_every_draw_is_a_configuration(composed: Compose, preset: str) -> None:
    from pinn_cli.search.space import read_space

    params = sweeper_of(preset).params
    space, fixed = read_space([f"{name}={value}" for name, value in params.items()])
    assert not fixed
    assert set(space) == set(params)
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=0))
    for _ in range(4):
        drawn = study.ask(space).params
        config = composed(f"experiment={preset}", *SMALL[:3], *(f"{name}={value}" for name, value in drawn.items()))
        assert RunConfig.read(config).validation.name == "heldout"


def test_there_is_one_for_every_kind_of_network() -> None:
    assert PRESETS == ["search/mlp", "search/mlp_by_gradients", "search/spline"]
