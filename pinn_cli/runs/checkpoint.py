"""The state of a run's trainings, kept on disk and taken up again; nothing in it is ever executed.

The last two checkpoints lie in the run's directory. Each is what `torch.save` writes, with the SHA-256 of its bytes as
the comment of the zip archive that it is: `torch.load(file, weights_only=True)` reads it. This seal is checked before
anything is unpacked.
"""

from __future__ import annotations

import copy
import hashlib
import logging
import math
import os
import random
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch.serialization import default_restore_location

from pinn_cli.runs.identity import Identity
from pinn_cli.runs.interruption import warned
from pinn_cli.runs.reading import check_layout, check_regular, stamp
from pinn_cli.runs.resume import AUTO, CHECKPOINTS
from pinn_cli.runs.writing import replacing
from pinn_cli.settings.errors import InputError

log = logging.getLogger(__name__)

LAST, PREVIOUS = CHECKPOINTS
FORMAT, SEAL_LENGTH = 1, 64
# What may come of a file whose seal is right but whose content is none of ours.
FORGED = (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError)


class DamagedCheckpointError(ValueError):
    """A file that is no whole checkpoint, or that was changed after it was written."""


class OtherRunError(ValueError):
    """A checkpoint of another run; says what differs, setting by setting."""


class Resumable(Protocol):
    """Whose state can be kept."""

    def state_dict(self) -> dict[str, Any]:
        """Tensors, numbers, strings, None, and dicts, lists and tuples of them."""

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from there."""


class CheckpointFiles:
    """`checkpoint.pt` and the one before it in a run's directory.

    Tensors that were saved on a GPU are put on the device, those of the CPU stay there.
    """

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
        with replacing(last) as temporary:
            with temporary.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            if self._last_is_good:  # a damaged one, or another run's, must not take a good one's place
                os.replace(last, previous)
        self._last_is_good = True
        if os.name != "nt":  # have the names on the disk too
            handle = os.open(self.directory, os.O_RDONLY)
            os.fsync(handle)
            os.close(handle)


class Checkpoints:
    """Those of one run, whose trainings come one after the other.

    Args:
        directory: Of the run.
        identity: Which run it is.
        every_s: Seconds from one to the next; None: none but on a signal and at the end.
        device: Of the run.
        clock: In seconds.

    Attributes:
        taken_up: Whether the trainings go on from what lies in the directory.
    """

    def __init__(
        self,
        directory: Path,
        identity: Identity,
        every_s: float | None,
        device: str = "cpu",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.identity, self.every_s, self.clock = identity, every_s, clock
        self.files, self.taken_up = CheckpointFiles(directory, device), False
        self._ended: list[dict[str, Any]] = []
        self._kept: list[dict[str, Any]] = []
        self._random: dict[str, Any] = {}
        self._last = clock()

    def take_up(self) -> bool:
        """Have the trainings go on where the last good checkpoint left them; False where there is none.

        Raises:
            OtherRunError: It is another run's; nothing has been changed.
            InputError: A later release wrote it.
        """
        content = self.files.read()
        if content is None:
            return False
        check_layout(content, FORMAT, self.files.directory / LAST)
        try:
            identity, kept, states = Identity(**content["identity"]), list(content["trainings"]), content["random"]
            changes = self.identity.changes_from(identity)
        except FORGED as error:
            raise OtherRunError(f"a checkpoint that pinn-run did not write ({error!r})") from error
        if changes:
            raise OtherRunError("; ".join(changes))
        self._kept, self._random, self.taken_up = kept, states, bool(kept)
        return True

    def begin(self, training: Resumable) -> bool:
        """Called before a training's first step; loads the state that it had. True where it had ended already.

        Raises:
            InputError: The state is not one of such a training.
        """
        self._last = self.clock()
        number = len(self._ended)
        if number >= len(self._kept):
            return False
        try:
            state, ended = (self._kept[number][name] for name in ("state", "ended"))
            training.load_state_dict(state)
            if number == len(self._kept) - 1:
                set_random_states(self._random)
        except FORGED as error:
            hint, place = f"{error!r}; remove checkpoint*.pt to start over", self.files.directory / LAST
            raise InputError("resume", place, "a checkpoint of this training", hint) from error
        if ended:
            self._ended.append(state)
        return bool(ended)

    def due(self) -> bool:
        """Whether it is time for the next one: the interval is over, or a scheduler has warned that it will kill."""
        return warned() or (self.every_s is not None and self.clock() - self._last >= self.every_s)

    def packed(self, training: Resumable, ended: bool = False) -> bytes:
        """The state of everything, as it is now."""
        self._last = self.clock()
        trainings = [{"ended": True, "state": state} for state in self._ended]
        trainings.append({"ended": ended, "state": training.state_dict()})
        said = stamp(FORMAT) | {"identity": asdict(self.identity)}
        return sealed(said | {"trainings": trainings, "random": random_states()})

    def write(self, packed: bytes) -> None:
        """Keep it, and the one before."""
        self.files.write(packed)

    def end(self, training: Resumable) -> None:
        """Called after a training's last step: what follows need not train again."""
        self.write(self.packed(training, ended=True))
        # A copy, since a further training may move the same network.
        self._ended.append(copy.deepcopy(training.state_dict()))


def open_checkpoints(
    directory: Path, identity: Identity, resume: str | None, every_s: float | None, device: str
) -> Checkpoints:
    """Those of a run that is about to train, taken up if it resumes; nothing in the directory is changed.

    ``resume`` says whether to go on with what lies there: None, `auto`, or that directory.

    Raises:
        InputError: The run was to be resumed by its directory's name, and the checkpoint there is another run's; or a
            later release wrote it.
    """
    checkpoints = Checkpoints(directory, identity, every_s, device)
    if resume is None:
        if any((directory / name).is_file() for name in CHECKPOINTS):
            log.warning("%s holds a checkpoint, which this run replaces: resume=auto would go on from it", directory)
        return checkpoints
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


def sealed(content: dict[str, Any]) -> bytes:
    """The bytes of a file that holds tensors, numbers, strings, None, and dicts, lists and tuples of them."""
    buffer = BytesIO()
    torch.save(content, buffer)
    body = buffer.getvalue()[:-2]  # before the length of the comment, of which torch writes none
    return body + SEAL_LENGTH.to_bytes(2, "little") + _seal(body)


def unsealed(data: bytes, device: str = "cpu") -> dict[str, Any]:
    """What was sealed, tensors included; those of a GPU on ``device``.

    Raises:
        DamagedCheckpointError: It is not as it was sealed, or holds something else than plain values and tensors.
    """
    if data[-SEAL_LENGTH:] != _seal(data[: -SEAL_LENGTH - 2]):
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


def random_states() -> dict[str, Any]:
    """All of them, as tensors and plain values."""
    kind, keys, *rest = np.random.get_state()  # noqa: NPY002
    version, words, gauss = random.getstate()
    return {
        "python": (version, torch.tensor(words, dtype=torch.int64), gauss),
        "numpy": (kind, torch.from_numpy(np.asarray(keys, dtype=np.int64)), *rest),
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_initialized() else [],
    }


def set_random_states(states: Mapping[str, Any]) -> None:
    """Put the generators back; those of GPUs that are not there are passed over."""
    version, words, gauss = states["python"]
    random.setstate((version, tuple(words.tolist()), gauss))
    kind, keys, *rest = states["numpy"]
    np.random.set_state((kind, keys.numpy().astype(np.uint32), *rest))  # noqa: NPY002
    torch.set_rng_state(states["torch"].cpu())
    if torch.cuda.is_available():
        for number, state in enumerate(states["cuda"][: torch.cuda.device_count()]):
            torch.cuda.set_rng_state(state.cpu(), number)
