"""The directories of a sweep and of its jobs, fixed by their overrides: the same command finds them again.

Registered as resolvers for `conf/config.yaml` when this module is imported, which every process that composes a job's
configuration does. Nothing slow is imported here.
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import json
import math
import re
from collections.abc import Collection, Iterable
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, Override, RangeSweep
from omegaconf import DictConfig, ListConfig, OmegaConf

from pinn_cli.runs.identity import is_left_out
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import setting_of

# File systems allow 255 bytes, of which Hydra, the tables and the figures want none; people want fewer.
LONGEST = 100
_DIGEST = 8
# Jobs of a sweep, unless more are asked for: a range with some zeros too many would fill the memory with their names.
MOST_JOBS = 10_000


@functools.lru_cache(maxsize=4096)
def parse(override: str) -> Override:
    """An override as typed (`seed=0,1`), read by Hydra's own grammar, which takes its time."""
    return OverridesParser.create().parse_override(override)


def combinations(overrides: Iterable[str], most: int = MOST_JOBS) -> list[list[str]]:
    """The jobs of a sweep: each setting's values with all others' values, the last one's next to each other.

    Args:
        overrides: As typed (`seed=0,1`); of those for one setting the last counts.
        most: How many jobs there may be.

    Returns:
        The overrides of each job.

    Raises:
        InputError: There are more, or a setting is given an interval, which has no list of values.
    """
    given = {override.get_key_element(): override for override in map(parse, overrides)}
    for name, override in given.items():
        if override.is_sweep_override() and not override.is_discrete_sweep():
            hint = "hydra/sweeper=search draws from intervals"
            raise InputError(name, _values(override), "a list of values, or a range", hint)
    counts = {name: _count(override) for name, override in given.items()}
    longest = max(counts, key=lambda name: counts[name], default="")
    if counts and (counts[longest] > most or math.prod(counts.values()) > most):
        hint = f"there would be {math.prod(counts.values())}; hydra.sweeper.max_jobs=... allows more"
        raise InputError(longest, _values(given[longest]), f"values that make at most {most} jobs", hint)
    return [list(job) for job in itertools.product(*(_single(name, each) for name, each in given.items()))]


def _values(override: Override) -> str:
    return str(override.input_line).partition("=")[2]


def _count(override: Override) -> float:
    """How many values there are, without making them."""
    value = override.value()
    if isinstance(value, RangeSweep):
        start, stop, step = (float(number or 0) for number in (value.start, value.stop, value.step))
        count = (stop - start) / step if step else 0.0
        return max(0, math.ceil(count)) if math.isfinite(count) else math.inf
    return len(value.list) if isinstance(value, ChoiceSweep) else 1


def _single(name: str, override: Override) -> list[str]:
    """The overrides that give a setting each of its values."""
    if not override.is_sweep_override():
        return [f"{name}={override.get_value_element_as_str()}"]
    return [f"{name}={value}" for value in override.sweep_string_iterator()]


def swept_settings(overrides: Iterable[str], params: Iterable[str] = ()) -> list[str]:
    """Settings that take more than one value in a sweep, by its overrides as typed and its sweeper's `params`."""
    swept = [override for override in overrides if parse(override).is_sweep_override()]
    return list(dict.fromkeys(map(setting_of, [*swept, *params])))


def job_name(overrides: Iterable[str], swept: Collection[str]) -> str:
    """Of a job, by its overrides: `noise.snr_db=50,seed=3`, and a digest of those that all jobs of the sweep share.

    Settings that do not change what a run computes (`threads`) are left out. What no file system takes, or is too long
    to read, is cut and told apart by a digest of all.

    Args:
        overrides: As Hydra hands them to the job.
        swept: Settings that tell the jobs apart.
    """
    kept = sorted(override for override in overrides if not is_left_out(setting_of(override)))
    own = ",".join(override for override in kept if setting_of(override) in swept) or "job"
    shared = [override for override in kept if setting_of(override) not in swept]
    safe = re.sub(r"[^\w.+=,~-]", "_", own, flags=re.ASCII)
    if safe != own or len(own) > LONGEST:
        return f"{safe[: LONGEST - _DIGEST - 1]}_{_digest(kept)}"
    return f"{own}_{_digest(shared)}" if shared else own


def sweep_name(overrides: Iterable[str], params: dict[str, Any]) -> str:
    """Of a sweep, by its overrides and its sweeper's `params`: the swept settings and a digest of all."""
    kept = sorted(override for override in overrides if not is_left_out(setting_of(override)))
    short = "-".join(re.split(r"[./@]", name)[-1] for name in swept_settings(kept, params))
    return f"{short[: LONGEST - _DIGEST - 1] or 'sweep'}_{_digest([*kept, json.dumps(params, sort_keys=True)])}"


def _digest(parts: list[str]) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:_DIGEST]


def register() -> None:
    """Make the resolvers `sweep_name`, `swept_settings` and `job_name` known to OmegaConf.

    The first two are cached, as Hydra's `${now:}` is: the jobs have overrides of their own and get them from the sweep,
    where :func:`pinn_cli.sweep.callback.note_sweep` has them resolved.
    """

    def of_sweep(overrides: ListConfig, params: DictConfig | None) -> str:
        return sweep_name(map(str, overrides), {str(k): str(v) for k, v in (params or {}).items()})

    def of_swept(overrides: ListConfig, params: DictConfig | None) -> str:
        return " ".join(swept_settings(map(str, overrides), map(str, params or ())))

    def of_job(overrides: ListConfig, swept: str) -> str:
        return job_name(map(str, overrides), swept.split())

    OmegaConf.register_new_resolver("sweep_name", of_sweep, use_cache=True, replace=True)
    OmegaConf.register_new_resolver("swept_settings", of_swept, use_cache=True, replace=True)
    OmegaConf.register_new_resolver("job_name", of_job, replace=True)


register()
