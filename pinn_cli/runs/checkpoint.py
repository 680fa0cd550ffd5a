"""The state of a run's trainings, kept on disk and taken up again."""

from __future__ import annotations

import copy
import logging
import random
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from pinn_cli.runs.checkpoint_files import LAST, PREVIOUS, CheckpointFiles, sealed
from pinn_cli.runs.identity import Identity
from pinn_cli.runs.interruption import warned
from pinn_cli.runs.layout import check_layout, stamp
from pinn_cli.runs.resume import AUTO
from pinn_cli.settings.errors import InputError

log = logging.getLogger(__name__)

FORMAT = 1
# What may come of a file whose seal is right but whose content is none of ours.
FORGED = (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError)


class Resumable(Protocol):
    """Whose state can be kept."""

    def state_dict(self) -> dict[str, Any]:
        """Tensors, numbers, strings, None, and dicts, lists and tuples of them."""

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from there."""


class OtherRunError(ValueError):
    """A checkpoint of another run.

    Attributes:
        changes: What differs, setting by setting.
    """

    def __init__(self, changes: list[str]) -> None:
        super().__init__("; ".join(changes))
        self.changes = changes


class Checkpoints:
    """Those of one run, whose trainings come one after the other.

    Args:
        directory: Of the run.
        identity: Which run it is.
        every_s: Seconds from one to the next; None: none but on a signal and at the end.
        device: Of the run.
        clock: In seconds.
    """

    def __init__(
        self,
        directory: Path,
        identity: Identity,
        every_s: float | None,
        device: str = "cpu",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.directory, self.identity, self.every_s, self.clock = directory, identity, every_s, clock
        self.files = CheckpointFiles(directory, device)
        self._ended: list[dict[str, Any]] = []
        self._kept: list[dict[str, Any]] = []
        self._random: dict[str, Any] = {}
        self._last = clock()

    @property
    def taken_up(self) -> bool:
        """Whether the trainings go on from what lies in the directory."""
        return bool(self._kept)

    def take_up(self) -> bool:
        """Have the trainings go on where the last good checkpoint left them; False where there is none.

        Raises:
            OtherRunError: It is another run's; nothing has been changed.
            InputError: A later release wrote it.
        """
        content = self.files.read()
        if content is None:
            return False
        check_layout(content, FORMAT, self.directory / LAST)
        try:
            identity, kept, states = Identity.read(content["identity"]), list(content["trainings"]), content["random"]
        except FORGED as error:
            raise OtherRunError([f"a checkpoint that pinn-run did not write ({error!r})"]) from error
        changes = self.identity.changes_from(identity)
        if changes:
            raise OtherRunError(changes)
        self._kept, self._random = kept, states
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
            hint = f"{error!r}; remove checkpoint*.pt to start over"
            raise InputError("resume", self.directory / LAST, "a checkpoint of this training", hint) from error
        if ended:
            self._ended.append(state)
        return bool(ended)

    def due(self) -> bool:
        """Whether it is time for the next one: the interval is over, or a scheduler has warned that it will kill."""
        if warned():
            return True
        return self.every_s is not None and self.clock() - self._last >= self.every_s

    def packed(self, training: Resumable, ended: bool = False) -> bytes:
        """The state of everything, as it is now."""
        self._last = self.clock()
        now = {"ended": ended, "state": training.state_dict()}
        before = [{"ended": True, "state": state} for state in self._ended]
        content = {
            **stamp(FORMAT),
            "identity": self.identity.content,
            "trainings": [*before, now],
            "random": random_states(),
        }
        return sealed(content)

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

    Args:
        directory: Of the run.
        identity: Which run it is.
        resume: Whether to go on with what lies there: None, `auto`, or that directory.
        every_s: See :class:`Checkpoints`.
        device: Of the run.

    Raises:
        InputError: The run was to be resumed by its directory's name, and the checkpoint there is another run's; or a
            later release wrote it.
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
