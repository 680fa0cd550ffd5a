"""Whether a run has finished, and `resume=`: going on with one that was interrupted, as its directory has it.

`pinn-run resume=DIRECTORY` is handled here, before Hydra makes a new directory; `resume=auto` is a setting like any
other. Either way the run's own files say which run they are of (:class:`pinn_cli.runs.identity.Identity`): `.hydra/`
may be of a run that was killed before it wrote any. Nothing slow is imported here: every job of a sweep is asked.
"""

from __future__ import annotations

import os
import shlex
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypedDict

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pinn_cli.runs.identity import HOW_IT_IS_MADE, Identity, is_left_out
from pinn_cli.runs.reading import DamagedError, check_layout, read_json, stamp
from pinn_cli.runs.writing import write_json
from pinn_cli.settings.errors import InputError, NotSoundError, shortened
from pinn_cli.settings.override_syntax import quoted, setting_of
from pinn_cli.settings.yaml_file import read_yaml

AUTO, NEVER, RESULT = "auto", "never", "run.json"
# What a run's directory says of its tracked run; and the choice of the config group under which nothing is tracked.
TRACKING, NONE = "tracking.json", "none"
# Of the layouts of both files and of `.hydra/`.
FORMAT = 1
RESUME_ALLOWED = "null, auto, never, or the directory of a run"
# What a run that goes on takes up, in its directory: checkpoints of a training in steps, finished chains of NUTS, and
# windows of a record.
CHECKPOINTS = ("checkpoint.pt", "checkpoint.previous.pt")
KEPT = (*CHECKPOINTS, "chains", "windows")
# What may be given with it: where and how a run is made, not what it computes.
GIVEN_BESIDE = tuple(name for name in HOW_IT_IS_MADE if name != "resume")


class Scored(TypedDict, total=False):
    """What `run.json` says of a validation."""

    score: float | None
    reason: str


class Trained(TypedDict, total=False):
    """What others read of what `run.json` says of a training."""

    model_log_evidence: float | None
    effective_parameters: dict[str, list[float | None]]
    sigma_discrepancy: float | None
    sigma_displacement: list[float | None]
    sigma_velocity: list[float | None]
    sigma_acceleration: list[float | None]
    sigma_force: list[float | None]
    sigma_ground_acceleration: list[float | None]
    sigma_support_displacement: list[float | None]
    sigma_support_velocity: list[float | None]
    sigma_support_acceleration: list[float | None]
    sigma_gauge: list[float | None]


class StoredParameter(TypedDict, total=False):
    """What `run.json` says of a parameter; what is not known is null."""

    name: str
    estimate: float | None
    std: float | None
    lower_90: float | None
    upper_90: float | None


class RunFile(TypedDict, total=False):
    """What is read of `run.json`, which says much more."""

    case: str
    seconds: dict[str, float | None]
    training: Trained
    seed: int
    device: str
    threads: int
    configuration: str
    observed: str
    verdict: str
    reasons: list[str]
    parameters: list[StoredParameter]
    validation: Scored
    baseline: dict[str, Any]


def is_finished(directory: Path, config: DictConfig, base: Path) -> bool:
    """Whether all results of a run lie there: the last file written says so.

    Relative paths of the data of its configuration, which is without its `hydra` node, start from ``base``.
    """
    kept = read_record(directory).get("configuration")
    try:
        return kept is not None and kept == Identity.of(config, base).configuration
    except (ValueError, OmegaConfBaseException):  # the run itself says what is wrong with its configuration
        return False


def read_record(directory: Path) -> RunFile:
    """What `run.json` says of the run in a directory; empty where there is none, or it is damaged.

    Raises:
        InputError: A later release wrote it.
    """
    try:
        return read_json(directory / RESULT, RunFile, FORMAT)
    except (OSError, DamagedError):
        return {}


def stored_score(directory: Path) -> float | None:
    """The validation score of a finished run; None where it has none."""
    return read_record(directory).get("validation", {}).get("score")


def check_sound(directory: Path) -> None:
    """See to it that the verdict on a finished run is sound.

    Raises:
        NotSoundError: It is not, or the run has none; its first reason is told.
    """
    content = read_record(directory)
    if content.get("verdict") != "sound":
        reason = next(iter(content.get("reasons", ())), "run.json has no verdict: resume=never runs it again")
        raise NotSoundError(f"the verdict is {content.get('verdict')}, and strict=true: {shortened(reason)}")


@dataclass(frozen=True)
class TrackingState:
    """The tracked run of a run.

    Attributes:
        tracking: Name of the config group's choice.
        configuration: Digest of the run's settings (`pinn_cli.runs.identity.Identity.configuration`).
        key: What finds it again; it is written down before the tracker hears of it, so that a kill leaves no orphan.
        ended: Whether the tracker has everything of a run that has finished.
    """

    tracking: str
    configuration: str
    key: str
    ended: bool = False

    @classmethod
    def read(cls, directory: Path) -> TrackingState | None:
        """Of the run in a directory; None where nothing was tracked, or the file is damaged.

        Raises:
            InputError: A later release wrote it.
        """
        try:
            state = read_json(directory / TRACKING, cls, FORMAT)
        except (OSError, DamagedError):
            return None
        return state if state.key.isalnum() else None

    def write(self, directory: Path) -> None:
        """Put it into the run's directory."""
        write_json(stamp(FORMAT) | asdict(self), directory / TRACKING)


def is_tracked(directory: Path, config: DictConfig) -> bool:
    """Whether the tracker that a configuration asks for has everything of the finished run in a directory."""
    name = tracking_of(config)
    state = TrackingState.read(directory)
    return name == NONE or (state is not None and state.tracking == name and state.ended)


def tracking_of(config: DictConfig) -> str:
    """The choice of the config group, by the module that its class is in; `NONE` where there is no class."""
    target = OmegaConf.select(config, "tracking._target_")
    return NONE if target is None else str(target).rpartition(".")[0].rpartition(".")[2]


def with_class_of_today(config: DictConfig) -> DictConfig:
    """A stored configuration, whose tracking may be named as it was when its classes were in `pinn_cli.tracking`."""
    target = str(OmegaConf.select(config, "tracking._target_"))
    if target.startswith("pinn_cli.tracking."):
        today = {**config.tracking, "_target_": target.replace("pinn_cli.", "pinn_cli.sweep.", 1)}
        config.tracking = {} if tracking_of(config) == NONE else today
    return config


def named_directory(overrides: Sequence[str]) -> str:
    """Of a run that overrides go on with, `resume=DIRECTORY`; "" where they name none."""
    named = [override.partition("=")[2].strip("'\"") for override in overrides if setting_of(override) == "resume"]
    return named[-1] if named and named[-1] not in ("null", AUTO, NEVER) else ""


@dataclass(frozen=True)
class StoredRun:
    """A run that `pinn-run resume=DIRECTORY` goes on with.

    Attributes:
        directory: Absolute.
        config: That the run was started with, as Hydra stored it.
        cwd: Where relative paths of its data start from.
        given: Settings of `GIVEN_BESIDE` on the command line that resumes it, as typed.
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
        directory = named_directory(options.overrides)
        if not directory:
            return None
        others = tuple(override for override in options.overrides if setting_of(override) != "resume")
        for name in ("multirun", "cfg"):
            if getattr(options, name):
                hint = "the same command again goes on with a sweep" if name == "multirun" else ""
                raise InputError("resume", directory, f"null, auto or never with --{name}", hint)
        for override in others:
            if not is_left_out(setting_of(override)):
                hint = f"a run that goes on keeps its own configuration: drop {override}"
                raise InputError("resume", directory, f"given alone or with {', '.join(GIVEN_BESIDE)}", hint)
        return cls._read(directory, others)

    @classmethod
    def _read(cls, given: str, others: tuple[str, ...]) -> StoredRun:
        directory = Path(given).absolute()
        if not directory.is_dir():
            raise InputError("resume", given, RESUME_ALLOWED, "there is no such directory")
        config, hydra = (directory / ".hydra" / name for name in ("config.yaml", "hydra.yaml"))
        if not config.is_file():
            sweep = (directory / "multirun.yaml").is_file()
            hint = "it is a sweep's: name one of its jobs" if sweep else "it holds no .hydra/config.yaml"
            raise InputError("resume", given, RESUME_ALLOWED, hint)
        try:
            stored, runtime = with_class_of_today(read_yaml(config)), read_yaml(hydra) if hydra.is_file() else None
            cwd = OmegaConf.select(runtime, "hydra.runtime.cwd") if runtime is not None else None
        except (InputError, OmegaConfBaseException) as error:
            hint = f"its .hydra/ cannot be read: {error}"
            raise InputError("resume", given, RESUME_ALLOWED, hint) from error
        check_layout(runtime or {}, FORMAT, hydra)
        return cls(directory, stored, Path(str(cwd)) if cwd else Path.cwd(), others)

    @property
    def arguments(self) -> list[str]:
        """For Hydra: the same directory, whose `.hydra/` stays as it is."""
        directory = quoted(str(self.directory))
        return [f"resume={directory}", *self.given, f"hydra.run.dir={directory}"]

    def configuration(self, composed: DictConfig) -> DictConfig:
        """The run's own, with what may differ taken from the command line's."""
        config = self.config.copy()
        for name in ("resume", *map(setting_of, self.given)):
            OmegaConf.update(config, name, OmegaConf.select(composed, name), force_add=True, merge=False)
        return config

    def finished(self) -> bool:
        """Whether there is nothing to do: it has all its results, and so has its tracker; another one was not given."""
        retracked = any(setting_of(override).partition(".")[0] == "tracking" for override in self.given)
        tracked = not retracked and is_tracked(self.directory, self.config)
        return tracked and is_finished(self.directory, self.config, self.cwd)

    @property
    def strict(self) -> bool:
        """Whether its verdict must be sound: as the command line that resumes it says, else as it was started."""
        given = [override.partition("=")[2] for override in self.given if setting_of(override) == "strict"]
        return given[-1].lower() == "true" if given else self.config.get("strict") is True

    def enter(self) -> None:
        """Make its paths mean what they meant, if that folder is still there."""
        if self.cwd.is_dir():
            os.chdir(self.cwd)


def going_on(config: DictConfig) -> DictConfig:
    """The configuration of a sweep's job, which goes on unless it is told otherwise or its directory is always new."""
    if config.get("resume", NEVER) is None and _has_fixed_directory():
        config = config.copy()
        config.resume = AUTO
    return config


def asked_to_resume(config: DictConfig, directory: Path) -> bool:
    """Whether a run may go on with what lies in its directory: its `resume` is judged, but for its type.

    Raises:
        InputError: It names another directory, or `auto` stands beside a directory that has the time in it.
    """
    resume = config.get("resume")
    if not isinstance(resume, str) or resume == NEVER:
        return False
    if resume != AUTO:
        if Path(resume) != directory:
            hint = "pinn-run resume=DIRECTORY, given alone"
            raise InputError("resume", resume, "null, auto or never in a file", hint)
        return True
    if not _has_fixed_directory():
        hint = "the default one is new at every start; pinn-run resume=DIRECTORY goes on with a run that has one"
        raise InputError("resume", AUTO, "given with a fixed hydra.run.dir (hydra.sweep.dir in a sweep)", hint)
    return True


def _has_fixed_directory() -> bool:
    """Whether the run that Hydra has started has the same directory at every start."""
    hydra = OmegaConf.to_container(HydraConfig.get(), resolve=False)
    sweep = HydraConfig.get().mode == RunMode.MULTIRUN
    return "${now:" not in hydra["sweep" if sweep else "run"]["dir"]  # type: ignore[index,call-overload]


def how_to_go_on(directory: Path, command: str = "") -> str:
    """What an interrupted run tells its user: whether it kept anything to go on from, and by which command."""
    kept, here = any((directory / name).exists() for name in KEPT), Path.cwd()
    place = directory.relative_to(here) if here in directory.parents else directory
    said = "to go on" if kept else "nothing is kept of it; to start over"
    return f"{said}: {command or shlex.join(['pinn-run', f'resume={place}'])}"
