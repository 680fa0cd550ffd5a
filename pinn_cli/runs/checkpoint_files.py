"""Checkpoints on disk: the last two, each there whole or not at all, sealed, and never executed.

A file is what `torch.save` writes, with the SHA-256 of its bytes as the comment of the zip archive that it is:
`torch.load(file, weights_only=True)` reads it. The seal is checked before anything is unpacked.
"""

from __future__ import annotations

import hashlib
import logging
import math
import os
from io import BytesIO
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch.serialization import default_restore_location

from pinn_cli.runs.reading import check_regular
from pinn_cli.runs.writing import replacing

LAST, PREVIOUS = "checkpoint.pt", "checkpoint.previous.pt"
SEAL_LENGTH = 64

log = logging.getLogger(__name__)


class DamagedCheckpointError(ValueError):
    """A file that is no whole checkpoint, or that was changed after it was written."""


class CheckpointFiles:
    """`checkpoint.pt` and the one before it in a run's directory.

    Args:
        directory: Of the run.
        device: Where tensors that were saved on a GPU are put; those of the CPU stay there.
    """

    NAMES: ClassVar[tuple[str, ...]] = (LAST, PREVIOUS)

    def __init__(self, directory: Path, device: str = "cpu") -> None:
        self.directory, self.device = directory, device
        self._last_is_good = False

    def read(self) -> dict[str, Any] | None:
        """The content of the last good one, None where there is none; a damaged file gets a line in the log."""
        for name, otherwise in ((LAST, "the previous checkpoint is tried"), (PREVIOUS, "training starts over")):
            place = self.directory / name
            try:
                check_regular(place, math.inf)
                content = unsealed(place.read_bytes(), self.device)
            except FileNotFoundError:
                continue
            except (OSError, DamagedCheckpointError) as error:
                log.warning("%s is damaged (%s): %s", place, error, otherwise)
                continue
            self._last_is_good = name == LAST
            return content
        return None

    def write(self, data: bytes) -> None:
        """Put sealed content on the disk; it is there, whole, when this returns.

        The last one becomes the previous one. Whenever the process ends, one of the two is good.
        """
        last, previous = self.directory / LAST, self.directory / PREVIOUS
        with replacing(last) as beside:
            with beside.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            if self._last_is_good:  # a damaged one, or another run's, must not take a good one's place
                os.replace(last, previous)
        self._last_is_good = True
        _sync(self.directory)


def sealed(content: dict[str, Any]) -> bytes:
    """The bytes of a file that holds tensors, numbers, strings, None, and dicts, lists and tuples of them."""
    buffer = BytesIO()
    torch.save(content, buffer)
    archive = buffer.getvalue()
    body, no_comment = archive[:-2], (0).to_bytes(2, "little")
    if archive[-2:] != no_comment:
        raise RuntimeError("torch.save wrote an archive with a comment, where the seal should go")
    return body + SEAL_LENGTH.to_bytes(2, "little") + _seal(body)


def unsealed(data: bytes, device: str = "cpu") -> dict[str, Any]:
    """What was sealed, tensors included; those of a GPU on ``device``.

    Raises:
        DamagedCheckpointError: It is not as it was sealed, or holds something else than plain values and tensors.
    """
    body = data[: -SEAL_LENGTH - 2]
    if data[-SEAL_LENGTH:] != _seal(body):
        raise DamagedCheckpointError("cut short or changed: its checksum is wrong")

    def place(storage: Any, saved_on: str) -> Any:
        return default_restore_location(storage, saved_on if saved_on == "cpu" else device)

    try:
        content = torch.load(BytesIO(data), map_location=place, weights_only=True)
    except Exception as error:  # zip, pickle or whatever else a file made by hand may break
        raise DamagedCheckpointError(f"not plain values and tensors: {type(error).__name__}") from error
    if not isinstance(content, dict):
        raise DamagedCheckpointError("not a checkpoint")
    return content


def _seal(body: bytes) -> bytes:
    return hashlib.sha256(body).hexdigest().encode()


def _sync(directory: Path) -> None:
    """Have the names in a directory on the disk too, where the system knows how."""
    if os.name == "nt":
        return
    handle = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
