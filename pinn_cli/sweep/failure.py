"""What a job of a sweep leaves behind when it fails: a file with its reason, so that it takes no other job along."""

from __future__ import annotations

import traceback
from dataclasses import asdict, dataclass
from pathlib import Path

from pinn_cli.runs.reading import DamagedError, read_json
from pinn_cli.runs.writing import WriteError, write_json
from pinn_cli.settings.errors import DivergenceError, InputError, NotSoundError

FILE = "failure.json"
# As the command's exit status: what a shell script must tell apart.
DEFECT, INPUT, STOPPED, NOT_SOUND = 1, 2, 3, 4
_STATUS = {InputError: INPUT, DivergenceError: STOPPED, WriteError: STOPPED, NotSoundError: NOT_SOUND}


class UnansweredError(RuntimeError):
    """What runs the jobs of a sweep elsewhere is not heard of any more, and they may go on."""


@dataclass(frozen=True)
class Failure:
    """Why a job ended without results.

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
            return read_json(directory / FILE, cls)
        except FileNotFoundError:
            return None
        except DamagedError as error:
            return cls(DEFECT, str(error), "")

    def write(self, directory: Path) -> None:
        """Put it into the job's directory."""
        write_json(asdict(self), directory / FILE)


def status_of(error: Exception) -> int:
    """The exit status of a run that ends with this error."""
    return next((status for kind, status in _STATUS.items() if isinstance(error, kind)), DEFECT)


def clear(directory: Path) -> None:
    """Remove it: the job in that directory begins again."""
    (directory / FILE).unlink(missing_ok=True)
