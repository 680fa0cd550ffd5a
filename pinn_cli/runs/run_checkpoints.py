"""Which of the checkpoints that lie in a run's directory the run goes on from."""

from __future__ import annotations

import logging
from pathlib import Path

from pinn_cli.runs.checkpoint import Checkpoints, OtherRunError
from pinn_cli.runs.checkpoint_files import LAST, PREVIOUS
from pinn_cli.runs.identity import Identity
from pinn_cli.runs.resume import AUTO
from pinn_cli.settings.errors import InputError

log = logging.getLogger(__name__)


def open_checkpoints(
    directory: Path, identity: Identity, resume: str | None, every_s: float | None, device: str
) -> Checkpoints:
    """Those of a run that is about to train, taken up if it resumes; nothing in the directory is changed.

    Args:
        directory: Of the run.
        identity: Which run it is.
        resume: Whether to go on with what lies there: None, `auto`, or that directory.
        every_s: See :class:`Checkpoints`.
        device: Of the run.

    Raises:
        InputError: The run was to be resumed by its directory's name, and the checkpoint there is another run's.
    """
    checkpoints = Checkpoints(directory, identity, every_s, device)
    found = any((directory / name).is_file() for name in (LAST, PREVIOUS))
    if resume is None:
        if found:
            log.warning("%s holds a checkpoint, which this run replaces: resume=auto would go on from it", directory)
    else:
        try:
            if checkpoints.take_up():
                log.info("going on from the checkpoint in %s", directory)
                return checkpoints
            log.info("%s holds no checkpoint to go on from: training starts over", directory)
        except OtherRunError as error:
            if resume != AUTO:
                allowed, hint = "a run whose checkpoint is its own", "remove checkpoint*.pt there to start over"
                raise InputError("resume", resume, f"{allowed}, but {error}", hint) from error
            log.warning("the checkpoint in %s is of another run: training starts over; %s", directory, error)
    return Checkpoints(directory, identity, every_s, device)
