"""The jobs of a sweep and what became of each, read off their directories while they run or long after."""

from __future__ import annotations

import os
import re
import traceback
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypedDict

import yaml
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pinn_cli.runs.claim import LOCK
from pinn_cli.runs.reading import DamagedError, checked, read_json, small_text
from pinn_cli.runs.resume import FORMAT, RESULT, RunFile
from pinn_cli.runs.writing import WriteError, write_json, write_text
from pinn_cli.settings.errors import DivergenceError, InputError, NotSoundError
from pinn_cli.settings.legal_values import whole_number
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.settings.yaml_file import read_yaml
from pinn_cli.sweep.composing import MOST_JOBS, combinations, job_name, parse, swept_settings

STATUSES = FINISHED, FAILED, UNFINISHED, NOT_STARTED = "finished", "failed", "unfinished", "not started"
# Columns of a sweep's tables, and the first of these.
STATUS, REASON, FITNESS = "status", "reason", "fitness.csv"
# The sweep's configuration with its `hydra` node, in its directory.
STORED = "multirun.yaml"
OVERRIDES = Path(".hydra") / "overrides.yaml"
FAILURE = "failure.json"
# What a job leaves when it begins, and when it ends.
SIGNS = (OVERRIDES, LOCK, RESULT, FAILURE)
# The sweepers of this package: see `hydra_plugins.pinn_run.sweepers`.
GRID, SEARCH = "BasicSweeper", "SearchSweeper"
# As the command's exit status: what a shell script must tell apart.
DEFECT, INPUT, STOPPED, NOT_SOUND = 1, 2, 3, 4
_STATUS = {InputError: INPUT, DivergenceError: STOPPED, WriteError: STOPPED, NotSoundError: NOT_SOUND}


class _Overrides(TypedDict):
    task: list[str]


class _Sweeper(TypedDict, total=False):
    params: dict[str, Any] | None


class _Hydra(TypedDict):
    sweep: dict[str, Any]
    sweeper: _Sweeper
    overrides: _Overrides


class SweepFile(TypedDict):
    """What is read of `multirun.yaml`."""

    hydra: _Hydra


@dataclass(frozen=True)
class Failure:
    """Why a job ended without results: a file that it leaves behind, so that it takes no other job along.

    Attributes:
        status: That a run of its own would have exited with.
        reason: In one line.
        traceback: As Python prints it.
    """

    status: int
    reason: str
    traceback: str

    @classmethod
    def of(cls, error: Exception) -> Failure:
        """What an exception means for the job that raised it."""
        status = status_of(error)
        reason = " ".join((f"{type(error).__name__}: {error}" if status == DEFECT else str(error)).split())
        return cls(status, reason, "".join(traceback.format_exception(error)))

    @classmethod
    def read(cls, directory: Path) -> Failure | None:
        """Of the job in that directory; None where it did not fail."""
        try:
            return read_json(directory / FAILURE, cls)
        except FileNotFoundError:
            return None
        except DamagedError as error:
            return cls(DEFECT, str(error), "")

    def write(self, directory: Path, overrides: Any) -> None:
        """Leave it in a job's directory, made where it is missing, and known for one even if the job never began.

        Raises:
            WriteError: The disk does not take it.
        """
        if not (directory / OVERRIDES).is_file():
            write_text(OmegaConf.to_yaml(overrides), directory / OVERRIDES)
        write_json(asdict(self), directory / FAILURE)


def status_of(error: Exception) -> int:
    """The exit status of a run that ends with this error."""
    return next((status for kind, status in _STATUS.items() if isinstance(error, kind)), DEFECT)


@dataclass(frozen=True)
class Job:
    """One job of a sweep.

    Attributes:
        directory: Where it lies, or will.
        overrides: As Hydra hands them to it, without those of `hydra.`.
        status: `finished`, `failed`, `unfinished` (it runs, or was cut off) or `not started`.
        reason: Why it failed, in one line.
        exit_status: That a run of its own would have exited with.
        seconds: That it took; None unless it is finished.
    """

    directory: Path
    overrides: tuple[str, ...]
    status: str = NOT_STARTED
    reason: str = ""
    exit_status: int = 0
    seconds: float | None = None

    @classmethod
    def read(cls, directory: Path, overrides: Sequence[str]) -> Job:
        """What lies in a directory."""
        failure = Failure.read(directory)
        if failure is not None:
            return cls(directory, tuple(overrides), FAILED, failure.reason, failure.status)
        if not (directory / RESULT).is_file():
            return cls(directory, tuple(overrides), UNFINISHED)
        try:
            seconds = read_json(directory / RESULT, RunFile, FORMAT).get("seconds", {})
        except (OSError, DamagedError, InputError) as error:
            return cls(directory, tuple(overrides), FAILED, str(error), INPUT)
        return cls(directory, tuple(overrides), FINISHED, seconds=seconds.get("total"))

    @property
    def ended(self) -> bool:
        """Whether there is nothing more to wait for."""
        return self.status in (FINISHED, FAILED)


@dataclass(frozen=True)
class Sweep:
    """A sweep's directory.

    Attributes:
        directory: Of the sweep.
        overrides: As typed for the whole sweep (`seed=0,1`).
        expected: The jobs' names and overrides in their order; empty if only its sweeper knows them.
        is_search: Whether Optuna chooses its jobs by their scores.
    """

    directory: Path
    overrides: tuple[str, ...]
    expected: dict[str, tuple[str, ...]]
    is_search: bool

    @classmethod
    def of(cls, config: Any, directory: Path) -> Sweep:
        """From the sweep's configuration as Hydra composed it, with its `hydra` node; too many jobs are refused."""
        overrides = [str(override) for override in OmegaConf.select(config, "hydra.overrides.task") or ()]
        named = "job_name" in str(OmegaConf.to_container(config.hydra.sweep, resolve=False))
        params = config.hydra.sweeper.get("params") or {}
        arguments = [*(f"{name}={value}" for name, value in params.items()), *overrides]
        most = whole_number("hydra.sweeper.max_jobs", config.hydra.sweeper.get("max_jobs", MOST_JOBS), least=1)
        sweeper = str(config.hydra.sweeper.get("_target_")).rpartition(".")[2]
        jobs = combinations(arguments, most) if named and sweeper == GRID else []
        swept = swept_settings(arguments, map(str, params))
        expected = {job_name(job, swept): tuple(job) for job in jobs}
        return cls(directory, tuple(arguments), expected, is_search=sweeper == SEARCH)

    @classmethod
    def read(cls, directory: Path) -> Sweep:
        """From the file that Hydra left in it; a directory that is no sweep's is refused."""
        allowed = "the directory of a sweep"
        if not directory.is_dir():
            raise InputError("collect", directory, allowed, "there is no such directory")
        stored = directory / STORED
        if not stored.is_file():
            hint = "this is a run's: its tables lie there already" if (directory / RESULT).is_file() else ""
            raise InputError("collect", directory, allowed, hint or f"it holds no {STORED}")
        try:
            config = read_yaml(stored)
            checked(OmegaConf.to_container(config), SweepFile)
            return cls.of(config, directory)
        except (ValueError, OmegaConfBaseException, HydraException) as error:
            raise InputError("collect", directory, allowed, f"its {STORED} cannot be read: {error}") from error

    @cached_property
    def fixed(self) -> set[str]:
        """Settings that were given one value for all jobs."""
        return {setting_of(override) for override in self.overrides if not parse(override).is_sweep_override()}

    def jobs(self) -> list[Job]:
        """Every job that is expected or has a directory, in the sweep's order; later additions by name."""
        places = {path.relative_to(self.directory).as_posix(): path for path in job_directories(self.directory)}
        jobs = []
        for name, overrides in self.expected.items():
            place = places.pop(name, None)
            jobs.append(Job(self.directory / name, overrides) if place is None else Job.read(place, overrides))
        others = (places[name] for name in sorted(places, key=_natural))
        return [*jobs, *(Job.read(place, stored_overrides(place)) for place in others)]

    def columns(self, job: Job) -> dict[str, str]:
        """The job's swept settings and their values, as text."""
        swept = [override for override in job.overrides if setting_of(override) not in self.fixed]
        return {setting_of(override): parse(override).get_value_element_as_str() for override in swept}


def written_since(directory: Path, moment: float, signs: Sequence[Path | str] = SIGNS) -> bool:
    """Whether a job has begun, perhaps anew, or ended in a directory at that moment or after it, as its files say.

    The moment is in seconds since the epoch, by the clock of the file system.
    """
    for sign in signs:
        with suppress(OSError):  # there is none
            if (directory / sign).stat().st_mtime >= moment:
                return True
    return False


def job_directories(sweep: Path) -> Iterator[Path]:
    """Directories below the sweep's that Hydra prepared for a job; nothing is looked for below those."""
    for place, folders, _ in os.walk(sweep):
        if (Path(place) / OVERRIDES).is_file():
            folders.clear()
            yield Path(place)


def stored_overrides(directory: Path) -> tuple[str, ...]:
    """Of a job, as Hydra left them in its directory; none where they cannot be read."""
    try:
        root = yaml.compose(small_text(directory / OVERRIDES), Loader=yaml.SafeLoader)
        nodes = root.value if isinstance(root, yaml.SequenceNode) else []
        overrides = tuple(node.value for node in nodes if isinstance(node, yaml.ScalarNode))
        single = len(overrides) == len(nodes) and not any(parse(override).is_sweep_override() for override in overrides)
    except (OSError, yaml.YAMLError, HydraException, RecursionError):  # cut off while Hydra wrote it, or not by it
        return ()
    return overrides if single else ()


def _natural(name: str) -> list[tuple[int, float, str]]:
    """An order in which 10 follows 9."""
    parts = re.split(r"(\d+(?:\.\d+)?)", name)
    return [(0, float(part), "") if index % 2 else (1, 0.0, part) for index, part in enumerate(parts)]
