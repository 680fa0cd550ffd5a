"""What a user typed and no run would use: it is told instead of passed over."""

from __future__ import annotations

import re
from collections.abc import Sequence

from omegaconf import DictConfig, OmegaConf

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.settings.registry import shipped

# The only group of which several options make sense, one over the other.
SEVERAL = "experiment"
# Settings that only a simulated record has, and what a measured one has instead.
OF_SIMULATIONS = {
    "noise": "a measured record brings its own noise",
    "simulation": "a measured record brings its own times",
    "excitation": "a measured record brings its own force",
    "scheme.unobserved": "data.holdout withholds sensors of a measured record",
    "scheme.unobserved_fraction": "data.holdout withholds sensors of a measured record",
    "scheme.sensors": "a measured record has the sensors that data.acceleration=... and the like name",
}


def check_choices(overrides: Sequence[str]) -> None:
    """Refuse a list of options where one is to be chosen; Hydra would lay them over each other.

    Args:
        overrides: As typed.

    Raises:
        InputError: Naming the group.
    """
    for override in overrides:
        group, _, chosen = override.lstrip("+").partition("=")
        if group.replace("/", ".") in shipped() and re.match(r"\s*\[", chosen):
            _refuse_several(group, chosen, chosen.strip(" []").replace(" ", ""))


def check_used(config: DictConfig, overrides: Sequence[str]) -> None:
    """Refuse what was typed and is not used.

    Args:
        config: Composed, with its `hydra` node.
        overrides: That it was composed under.

    Raises:
        InputError: At the first of them; or where a file chooses several options of a group.
    """
    for group, chosen in config.hydra.runtime.choices.items():
        if OmegaConf.is_list(chosen) and group != SEVERAL:
            _refuse_several(group, str(chosen), ",".join(map(str, chosen)))
    kind = OmegaConf.select(config, "data.kind")
    if kind in (None, "simulated"):
        return
    for override in overrides:
        for name, instead in OF_SIMULATIONS.items():
            setting = setting_of(override)
            if f"{setting}.".startswith(f"{name}.") and not override.startswith("~"):
                raise InputError(setting, override.partition("=")[2], f"left out with data={kind}", instead)


def _refuse_several(group: str, chosen: str, options: str) -> None:
    raise InputError(group, chosen, "one option", f"pinn-run --multirun {group}={options} makes a run with each")
