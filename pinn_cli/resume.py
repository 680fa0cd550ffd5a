"""`resume=`: going on with a run that was interrupted, with the configuration that lies in its directory.

`pinn-run resume=DIRECTORY` is handled here, before Hydra makes a new directory; `resume=auto` is a setting like any
other. Either way the run's own files say which run they are of (:class:`pinn_cli.identity.Identity`): Hydra has
rewritten `.hydra/` by the time that a run with a fixed directory sees it. Nothing slow is imported here.
"""

from __future__ import annotations

import json
import os
import shlex
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from pinn_cli.errors import InputError
from pinn_cli.identity import LEFT_OUT, Identity, is_left_out
from pinn_cli.quoting import quoted

if TYPE_CHECKING:
    from pinn_cli.config import RunConfig

AUTO, RESULT = "auto", "run.json"
ALLOWED = "null, auto, or the directory of a run"
# What may be given with it: where and how a run is made, not what it computes.
BESIDE = tuple(name for name in LEFT_OUT if name != "resume")


@dataclass(frozen=True)
class StoredRun:
    """A run that `pinn-run resume=DIRECTORY` goes on with.

    Attributes:
        directory: Absolute.
        config: That the run was started with, as Hydra stored it.
        cwd: Where relative paths of its data start from.
        given: Settings of `BESIDE` on the command line that resumes it, as typed.
    """

    directory: Path
    config: DictConfig
    cwd: Path
    given: tuple[str, ...] = ()

    @classmethod
    def asked_for(cls, options: Namespace) -> StoredRun | None:
        """The run that the command line names; None where it names none.

        Raises:
            InputError: There is no such run, or something else is asked for along with it.
        """
        named = [override for override in options.overrides if _name(override) == "resume"]
        directory = named[-1].partition("=")[2].strip("'\"") if named else ""
        if directory in ("", "null", AUTO):
            return None
        others = tuple(override for override in options.overrides if override not in named)
        for name in ("multirun", "cfg", "info"):
            if getattr(options, name):
                hint = "a sweep goes on with resume=auto and a fixed hydra.sweep.dir" if name == "multirun" else ""
                raise InputError("resume", directory, f"null or auto with --{name}", hint)
        for override in others:
            if _name(override) == "resume" or not is_left_out(_name(override)):
                hint = f"a run that goes on keeps its own configuration: drop {override}"
                raise InputError("resume", directory, f"given alone or with {', '.join(BESIDE)}", hint)
        return cls._read(directory, others)

    @classmethod
    def _read(cls, given: str, others: tuple[str, ...]) -> StoredRun:
        directory = Path(given).absolute()
        if not directory.is_dir():
            raise InputError("resume", given, ALLOWED, "there is no such directory")
        config, hydra = (directory / ".hydra" / name for name in ("config.yaml", "hydra.yaml"))
        if not config.is_file():
            sweep = (directory / "multirun.yaml").is_file()
            hint = "it is a sweep's: name one of its jobs" if sweep else "it holds no .hydra/config.yaml"
            raise InputError("resume", given, ALLOWED, hint)
        try:
            stored, runtime = OmegaConf.load(config), OmegaConf.load(hydra) if hydra.is_file() else None
            cwd = OmegaConf.select(runtime, "hydra.runtime.cwd") if runtime is not None else None
        except (OSError, UnicodeError, YAMLError, OmegaConfBaseException) as error:
            hint = f"its .hydra/ cannot be read: {error}"
            raise InputError("resume", given, ALLOWED, hint) from error
        if not isinstance(stored, DictConfig):
            raise InputError("resume", given, ALLOWED, "its .hydra/config.yaml holds no settings")
        return cls(directory, stored, Path(str(cwd)) if cwd else Path.cwd(), others)

    @property
    def arguments(self) -> list[str]:
        """For Hydra: the same directory, whose `.hydra/` stays as it is."""
        return [
            f"resume={quoted(str(self.directory))}",
            *self.given,
            f"hydra.run.dir={quoted(str(self.directory))}",
            "hydra.output_subdir=null",
        ]

    def configuration(self, composed: DictConfig) -> DictConfig:
        """The run's own, with what may differ taken from the command line's."""
        config = self.config.copy()
        for name in ("resume", *map(_name, self.given)):
            OmegaConf.update(config, name, OmegaConf.select(composed, name), force_add=True, merge=False)
        return config

    def finished(self) -> bool:
        """Whether it has all its results."""
        try:
            return is_finished(self.directory, Identity.of(self.config, self.cwd))
        except OmegaConfBaseException:  # the run itself says what is wrong with it
            return False

    def enter(self) -> None:
        """Make its paths mean what they meant, if that folder is still there."""
        if self.cwd.is_dir():
            os.chdir(self.cwd)


def is_finished(directory: Path, identity: Identity) -> bool:
    """Whether all results of that run lie there: the last file written says so."""
    try:
        content = json.loads((directory / RESULT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(content, dict) and content.get("configuration") == identity.configuration


def stored_score(directory: Path) -> float | None:
    """The validation score of a finished run; None where it has none."""
    score = json.loads((directory / RESULT).read_text(encoding="utf-8")).get("validation", {}).get("score")
    return None if score is None else float(score)


def asked_to_resume(config: RunConfig, directory: Path) -> bool:
    """Whether a run may go on with what lies in its directory.

    Args:
        config: Its `resume` is judged.
        directory: Of the run; whether it is the same at every start is asked of Hydra.

    Raises:
        InputError: It names another directory, or `auto` stands beside a directory that has the time in it.
    """
    if config.resume is None:
        return False
    if config.resume != AUTO:
        if Path(config.resume) != directory:
            raise InputError(
                "resume", config.resume, "null or auto in a file", "pinn-run resume=DIRECTORY, given alone"
            )
        return True
    hydra = OmegaConf.to_container(HydraConfig.get(), resolve=False)
    if "${now:" in hydra["sweep" if HydraConfig.get().mode == RunMode.MULTIRUN else "run"]["dir"]:  # type: ignore[index,call-overload]
        hint = "the default one is new at every start; pinn-run resume=DIRECTORY goes on with a run that has one"
        raise InputError("resume", AUTO, "given with a fixed hydra.run.dir (hydra.sweep.dir in a sweep)", hint)
    return True


def _name(override: str) -> str:
    return override.partition("=")[0].lstrip("+~")


def resume_command(directory: Path) -> str:
    """What a user types to go on."""
    here = Path.cwd()
    return shlex.join(["pinn-run", f"resume={directory.relative_to(here) if here in directory.parents else directory}"])
