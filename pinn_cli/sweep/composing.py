"""The jobs of a sweep by their overrides: which there are, what their directories are called, how they are composed.

The same command finds the directories again: they are fixed by the overrides. Their names are resolvers for
`conf/config.yaml`, registered when this module is imported, which every process that composes a job's configuration
does. Nothing slow is imported here.

Jobs that differ in numbers only are copies. Hydra composes every job from all its files anew: 0.144 s for each of 64
jobs that differ in their seeds, of some 2 s that a default job takes; this takes 0.007 s (one core, Hydra 1.3.8). A
number that a setting is given says nothing about which files those are: Hydra itself puts it in at the end.
"""

from __future__ import annotations

import copy
import hashlib
import itertools
import json
import math
import re
from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, Override, RangeSweep
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pinn_cli.runs.identity import is_left_out
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import NUMERAL
from pinn_cli.settings.override_syntax import setting_of

# Jobs of a sweep, unless more are asked for: a range with some zeros too many would fill the memory with their names.
MOST_JOBS = 10_000
# File systems allow 255 bytes, of which Hydra, the tables and the figures want none; people want fewer.
LONGEST_OF_JOB = 100
_DIGEST = 8
# Configurations without their numbers, of a sweep.
_KEPT = 64


@lru_cache(maxsize=4096)
def parse(override: str) -> Override:
    """An override as typed (`seed=0,1`), read by Hydra's own grammar, which takes its time."""
    return OverridesParser.create().parse_override(override)


def combinations(overrides: Iterable[str], most: int = MOST_JOBS) -> list[list[str]]:
    """The overrides of each job: each setting's values with all others' values, the last one's next to each other.

    Of overrides for one setting, as typed (`seed=0,1`), the last counts.

    Raises:
        InputError: There are more, or a setting is given an interval, which has no list of values.
    """
    given = {override.get_key_element(): override for override in map(parse, overrides)}
    counts = {name: _count(name, override) for name, override in given.items()}
    longest = max(counts, key=lambda name: counts[name], default="")
    if counts and (counts[longest] > most or math.prod(counts.values()) > most):
        hint = f"there would be {math.prod(counts.values())}; hydra.sweeper.max_jobs=... allows more"
        raise InputError(longest, _typed(given[longest]), f"values that make at most {most} jobs", hint)
    values = [
        o.sweep_string_iterator() if o.is_sweep_override() else [o.get_value_element_as_str()] for o in given.values()
    ]
    return [[f"{name}={value}" for name, value in zip(given, job, strict=True)] for job in itertools.product(*values)]


def _typed(override: Override) -> str:
    return str(override.input_line).partition("=")[2]


def _count(name: str, override: Override) -> float:
    """How many values there are, without making them."""
    if override.is_sweep_override() and not override.is_discrete_sweep():
        hint = "hydra/sweeper=search draws from intervals"
        raise InputError(name, _typed(override), "a list of values, or a range", hint)
    value = override.value()
    if isinstance(value, RangeSweep):
        start, stop, step = (float(number or 0) for number in (value.start, value.stop, value.step))
        count = (stop - start) / step if step else 0.0
        return max(0, math.ceil(count)) if math.isfinite(count) else math.inf
    return len(value.list) if isinstance(value, ChoiceSweep) else 1


def swept_settings(overrides: Iterable[str], params: Iterable[str] = ()) -> list[str]:
    """Settings that take more than one value in a sweep, by its overrides as typed and its sweeper's `params`."""
    swept = [override for override in overrides if parse(override).is_sweep_override()]
    return list(dict.fromkeys(map(setting_of, [*swept, *params])))


def job_name(overrides: Iterable[str], swept: Collection[str]) -> str:
    """Of a job, by its overrides: `noise.snr_db=50,seed=3`, and a digest of those that all jobs of the sweep share.

    Settings that do not change what a run computes (`threads`) are left out; those that tell the jobs apart are
    ``swept``. What no file system takes, or is too long to read, is cut and told apart by a digest of all.
    """
    kept = sorted(override for override in overrides if not is_left_out(setting_of(override)))
    name = ",".join(override for override in kept if setting_of(override) in swept) or "job"
    shared = [override for override in kept if setting_of(override) not in swept]
    safe = re.sub(r"[^\w.+=,~-]", "_", name, flags=re.ASCII)
    if safe != name or len(name) > LONGEST_OF_JOB:
        return f"{safe[: LONGEST_OF_JOB - _DIGEST - 1]}_{_digest(kept)}"
    return f"{name}_{_digest(shared)}" if shared else name


def sweep_name(overrides: Iterable[str], params: dict[str, Any]) -> str:
    """Of a sweep, by its overrides and its sweeper's `params`: the swept settings and a digest of all."""
    kept = sorted(override for override in overrides if not is_left_out(setting_of(override)))
    short = "-".join(re.split(r"[./@]", name)[-1] for name in swept_settings(kept, params))
    return f"{short[: LONGEST_OF_JOB - _DIGEST - 1] or 'sweep'}_{_digest([*kept, json.dumps(params, sort_keys=True)])}"


def _digest(parts: list[str]) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:_DIGEST]


def representatives(jobs: Sequence[Sequence[str]]) -> list[Sequence[str]]:
    """The first job with each override, the numbers that a setting is given being all alike.

    They stand for all when a sweep is checked, one job after the other before any starts: composing tells that a
    setting or an option is unknown, which the number that a setting is given cannot change.
    """
    chosen: dict[str, Sequence[str]] = {}
    for job in jobs:
        for override in job:
            chosen.setdefault(setting_of(override) if is_number(override) else override, job)
    return [list(job) for job in dict.fromkeys(tuple(job) for job in chosen.values())]


class Composer:
    """Composes the jobs of a sweep by Hydra's loader, from the sweep's configuration with its `hydra` node."""

    def __init__(self, loader: ConfigLoader, sweep: DictConfig) -> None:
        self.loader, self.sweep = loader, sweep
        self._without_numbers = lru_cache(_KEPT)(self._composed)

    def job(self, overrides: Sequence[str]) -> DictConfig:
        """The configuration of the job with these overrides.

        Raises:
            Exception: Whatever Hydra says of overrides that cannot be composed.
        """
        numbers, copied = own_numbers(overrides), None
        with suppress(OmegaConfBaseException):
            copied = self._copy_with(numbers, overrides) if numbers else None
        return self._composed(tuple(overrides)) if copied is None else copied

    def _composed(self, overrides: tuple[str, ...]) -> DictConfig:
        return self.loader.load_sweep_config(self.sweep, list(overrides))

    def _copy_with(self, numbers: list[str], overrides: Sequence[str]) -> DictConfig | None:
        without = self._without_numbers(tuple(override for override in overrides if override not in numbers))
        config, parsed = copy.deepcopy(without), [parse(override) for override in overrides]
        for override in parsed:
            if override.input_line in numbers:
                if OmegaConf.is_config(OmegaConf.select(config, override.key_or_group)):
                    return None  # it is no setting but a group, whose options are words: Hydra says so
                OmegaConf.update(config, override.key_or_group, override.value(), merge=True)
        of_task = [override for override in parsed if not override.is_hydra_override()]
        config.hydra.overrides.task = [override.input_line for override in of_task]
        named = config.hydra.job.config.override_dirname
        lines = sorted(str(o.input_line) for o in of_task if o.key_or_group not in named.exclude_keys)
        config.hydra.job.override_dirname = named.item_sep.join(lines).replace("=", named.kv_sep)
        OmegaConf.copy_cache(from_config=self.sweep, to_config=config)
        return config


def is_number(override: str) -> bool:
    """Whether the override gives a setting a number, as `seed=3` and `+seed=3` do and `scheme=bayesian` does not."""
    return NUMERAL.fullmatch(override.partition("=")[2]) is not None


def own_numbers(overrides: Sequence[str]) -> list[str]:
    """Those that give a setting a number, where no other override is about the same setting or one above or below it.

    Hydra's own settings are left out, since they may say how a job is composed, and those that are added.
    """
    names = [f"{setting_of(override)}." for override in overrides]
    return [
        override
        for override, name in zip(overrides, names, strict=True)
        if is_number(override) and override.startswith(name[:-1]) and not name.startswith("hydra.")
        and sum(other.startswith(name) or name.startswith(other) for other in names) == 1
    ]  # fmt: skip


def _sweep_name(overrides: ListConfig, params: DictConfig | None) -> str:
    return sweep_name(map(str, overrides), {str(k): str(v) for k, v in (params or {}).items()})


def _swept_settings(overrides: ListConfig, params: DictConfig | None) -> str:
    return " ".join(swept_settings(map(str, overrides), map(str, params or ())))


def _job_name(overrides: ListConfig, swept: str) -> str:
    return job_name(map(str, overrides), swept.split())


# The first two are cached, as Hydra's `${now:}` is: the jobs have overrides of their own and get them from the sweep,
# where `pinn_cli.sweep.running.note_sweep` has them resolved.
OmegaConf.register_new_resolver("sweep_name", _sweep_name, use_cache=True, replace=True)
OmegaConf.register_new_resolver("swept_settings", _swept_settings, use_cache=True, replace=True)
OmegaConf.register_new_resolver("job_name", _job_name, replace=True)
