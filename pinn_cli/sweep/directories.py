"""The directories of a sweep and of its jobs, fixed by their overrides: the same command finds them again.

Registered as resolvers for `conf/config.yaml` when this module is imported, which every process that composes a job's
configuration does. Nothing slow is imported here.
"""

from __future__ import annotations

import functools
import hashlib
import json
import re
from collections.abc import Collection, Iterable
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, ListConfig, OmegaConf

from pinn_cli.runs.identity import is_left_out
from pinn_cli.settings.override_syntax import setting_of

# File systems allow 255 bytes, of which Hydra, the tables and the figures want none; people want fewer.
LONGEST = 100
_DIGEST = 8


@functools.lru_cache(maxsize=4096)
def parse(override: str) -> Override:
    """An override as typed (`seed=0,1`), read by Hydra's own grammar, which takes its time."""
    return OverridesParser.create().parse_override(override)


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
    where :func:`pinn_cli.sweep.running.note_sweep` has them resolved.
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
