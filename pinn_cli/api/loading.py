"""`load`: what a directory holds, a run's or a sweep's."""

from __future__ import annotations

import os
from pathlib import Path

from pinn_cli.api.result import Result
from pinn_cli.api.sweep import SweepResult
from pinn_cli.runs.resume import RESULT
from pinn_cli.settings.errors import InputError
from pinn_cli.sweep.jobs import STORED


def load(directory: str | os.PathLike[str]) -> Result | SweepResult:
    """Open the directory of a finished run, or of a sweep, whose runs may still be under way. Nothing is changed there.

    Args:
        directory: As the command prints it at its end.

    Returns:
        The result; of a sweep those of its runs, with their tables joined.

    Raises:
        InputError: It is neither, or the run has not finished.
    """
    place = Path(directory).expanduser().absolute()
    allowed = "the directory of a finished run or of a sweep"
    if not place.is_dir():
        raise InputError("directory", directory, allowed, "there is no such directory")
    if (place / RESULT).is_file():
        return Result(place)
    if (place / STORED).is_file():
        return SweepResult(place)
    hint = "it holds no run.json"
    if (place / ".hydra").is_dir():
        hint = f"the run has not finished: run('resume={place}') goes on with it"
    raise InputError("directory", directory, allowed, hint)
