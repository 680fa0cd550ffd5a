"""Whose a directory is: a run writes only where nothing lies, or where `pinn-run` has written before.

Hydra makes a run's directory before the task sees the configuration. A command that its input makes impossible must
leave nothing behind, and must not touch what was there before it.
"""

from __future__ import annotations

import os
import re
import shutil
import stat
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from pinn_cli.runs.lock import if_free
from pinn_cli.runs.reading import small_text
from pinn_cli.settings.errors import InputError

SETTINGS = ".hydra"
# The files of a run's and of a sweep's directory that carry the mark: the name of the package, among Hydra's settings.
MARKED = (f"{SETTINGS}/hydra.yaml", "multirun.yaml")
MARK = "pinn_cli"
# What may lie in a directory that was prepared and never begun: by pattern, with files that were being written.
_PREPARED = re.compile(r"(run|sweep)\.lock|failure\.json|\.submitit|\.(failure|multirun)\.\d+\.partial\.(json|yaml)")
_PREPARED_SETTINGS = re.compile(r"overrides\.yaml|\.(hydra|config|overrides)\.\d+\.partial\.yaml")
_FILES = re.compile(r".*\.(csv|db|json|pt|nc|log|lock|yaml)")
_FOLDERS = (SETTINGS, "figures", "chains", "tensorboard")
ALLOWED = "a new or empty directory, or one that pinn-run made"

# Directories that did not exist before the run or sweep that was started last, its own first.
_new: list[Path] = []


def check_destination(directory: Path, setting: str) -> None:
    """See to it that a run, or a sweep, may write into a directory.

    Args:
        directory: Exists.
        setting: That named it.

    Raises:
        InputError: It holds files that are not of `pinn-run`, or something else in the place of a file.
    """
    try:
        entries = sorted(directory.iterdir())
    except OSError as error:
        raise InputError(setting, directory, ALLOWED, error.strerror or str(error)) from error
    if not is_ours(directory):
        foreign = [entry.name for entry in entries if not is_prepared(entry)]
        if foreign:
            named = ", ".join(foreign[:3]) + (", ..." if len(foreign) > 3 else "")
            hint = f"files of yours might be replaced there ({named}): name another directory"
            raise InputError(setting, directory, ALLOWED, hint)
    settings = directory / SETTINGS
    _check_kinds([*entries, *(sorted(settings.iterdir()) if settings.is_dir() else ())], setting)


def made(directory: Path, setting: str) -> Path:
    """A directory, made where it is missing.

    Raises:
        InputError: It cannot be made.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(setting, directory, "a directory that can be made", error.strerror or str(error)) from error
    return directory


def is_ours(directory: Path) -> bool:
    """Whether `pinn-run` has written into a directory before."""
    return any(_carries_mark(directory / name) for name in MARKED)


def _carries_mark(file: Path) -> bool:
    try:
        return MARK in small_text(file)
    except OSError:
        return False


def is_prepared(entry: Path) -> bool:
    """Whether an entry of a directory is one that a run, or a job, leaves before it has begun."""
    if entry.name == SETTINGS and entry.is_dir():
        return all(_PREPARED_SETTINGS.fullmatch(inner.name) for inner in entry.iterdir())
    return _PREPARED.fullmatch(entry.name) is not None


def _check_kinds(entries: Iterable[Path], setting: str) -> None:
    """Where a run would write a file there must be a file or nothing: no folder, FIFO or link to another place."""
    for entry in entries:
        kind = entry.lstat().st_mode
        if entry.name in _FOLDERS and not stat.S_ISDIR(kind):
            raise InputError(setting, entry.parent, ALLOWED, f"{entry.name} there is no directory")
        if _FILES.fullmatch(entry.name) and not stat.S_ISREG(kind):
            raise InputError(setting, entry.parent, ALLOWED, f"{entry.name} there is no regular file")


def note_new(directory: Path) -> None:
    """Note the directory of a run or of a sweep, and its parents, as far as they are missing."""
    path = directory.absolute()
    _new[:] = [p for p in (path, *path.parents) if not os.path.lexists(p)]


def discard() -> None:
    """Remove what unusable input left: directories that are new, and in which nobody is nor any run was begun."""
    for directory in _new[:1]:
        if _is_unused(directory):
            with if_free(directory) as free:
                if free and _is_unused(directory):
                    shutil.rmtree(directory)
    for directory in _new[1:]:
        with suppress(OSError):  # it holds something, or was not made
            directory.rmdir()


def _is_unused(directory: Path) -> bool:
    # `Path.is_dir` raises where a name is too long
    return os.path.isdir(directory) and all(map(is_prepared, directory.iterdir()))
