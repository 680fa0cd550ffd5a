"""How the jobs of a sweep are composed: those that differ in numbers only are made from one another.

Hydra composes every job from all its files anew: 0.144 s for each of 64 jobs that differ in their seeds, of some 2 s
that a default job takes; this takes 0.007 s (one core, Hydra 1.3.8). A number that a setting is given says nothing
about which files those are: Hydra itself puts it in at the end. So it is put into a copy here.
"""

from __future__ import annotations

import copy
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pinn_cli.settings.override_syntax import setting_of

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")

# Without the numbers; of this process.
_composed: dict[Any, DictConfig] = {}
_KEPT = 64


def compose_job(loader: ConfigLoader, sweep: DictConfig, overrides: Sequence[str]) -> DictConfig:
    """Compose a job.

    Args:
        loader: Hydra's.
        sweep: Configuration of the sweep, with its `hydra` node.
        overrides: Of the job.

    Raises:
        Exception: Whatever Hydra says of overrides that cannot be composed.
    """
    numbers = own_numbers(overrides)
    if numbers:
        with suppress(OmegaConfBaseException, _NotASettingError):
            return _put_into_copy(loader, sweep, overrides, numbers)
    return loader.load_sweep_config(sweep, list(overrides))


class _NotASettingError(Exception):
    pass


def _put_into_copy(loader: ConfigLoader, sweep: DictConfig, overrides: Sequence[str], numbers: list[str]) -> DictConfig:
    config = _without(loader, sweep, [override for override in overrides if override not in numbers])
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    for override in parsed:
        if override.input_line in numbers:
            if OmegaConf.is_config(OmegaConf.select(config, override.key_or_group)):
                raise _NotASettingError  # but a group, whose options are words: Hydra says so
            OmegaConf.update(config, override.key_or_group, override.value(), merge=True)
    of_task = [override for override in parsed if not override.is_hydra_override()]
    config.hydra.overrides.task = [override.input_line for override in of_task]
    if not OmegaConf.is_interpolation(config.hydra.job, "override_dirname"):  # as Hydra 1.4 has it
        named = config.hydra.job.config.override_dirname
        lines = sorted(str(o.input_line) for o in of_task if o.key_or_group not in named.exclude_keys)
        config.hydra.job.override_dirname = named.item_sep.join(lines).replace("=", named.kv_sep)
    OmegaConf.copy_cache(from_config=sweep, to_config=config)
    return config


def _without(loader: ConfigLoader, sweep: DictConfig, overrides: list[str]) -> DictConfig:
    """A copy of what Hydra composes of the other overrides."""
    sources = tuple((source.provider, source.path) for source in loader.get_search_path().get_path())
    hydra = sweep.hydra
    key = (hydra.job.config_name, sources, tuple(hydra.overrides.hydra), os.getcwd(), tuple(overrides))
    if key not in _composed:
        if len(_composed) == _KEPT:
            del _composed[next(iter(_composed))]
        _composed[key] = loader.load_sweep_config(sweep, overrides)
    return copy.deepcopy(_composed[key])


def is_number(override: str) -> bool:
    """Whether the override gives a setting a number, as `seed=3` and `+seed=3` do and `scheme=bayesian` does not."""
    return _NUMBER.fullmatch(override.partition("=")[2]) is not None


def own_numbers(overrides: Sequence[str]) -> list[str]:
    """Those that give a setting a number, where no other override is about the same setting or one above or below it.

    Hydra's own settings are left out, since they may say how a job is composed, and those that are added.
    """
    names = [setting_of(override) for override in overrides]

    def is_own(name: str) -> bool:
        return sum(f"{other}.".startswith(f"{name}.") or f"{name}.".startswith(f"{other}.") for other in names) == 1

    return [
        override
        for override, name in zip(overrides, names, strict=True)
        if is_number(override) and override.startswith(name) and not name.startswith("hydra.") and is_own(name)
    ]
