"""Trainings that go on step by step, and so can be interrupted and taken up again."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import deepcopy
from typing import TYPE_CHECKING, Any, ClassVar

from pinn_cli.runs.checkpoint import random_states, set_random_states
from pinn_cli.runs.interruption import Interruption, asked, deferred, heeded
from pinn_cli.training.estimate import RunContext

if TYPE_CHECKING:
    from pinn_cli.runs.checkpoint import Checkpoints


class Stepwise(ABC):
    """A training under way: everything that its next step depends on is in its state.

    Attributes:
        long_steps: Whether a step may take so long that a signal breaks it off; it is then taken anew on resuming.
    """

    long_steps: ClassVar[bool] = False

    @abstractmethod
    def step(self) -> bool:
        """Do one iteration; False, having done nothing, where training has ended.

        Raises:
            DivergenceError: The loss left the finite numbers.
        """

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """Tensors, numbers, strings, and dicts and lists of them: all that is needed to go on as if never stopped."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state of a training of the same settings and problem."""


def train(training: Stepwise, run: RunContext) -> None:
    """Step until the training has ended, from where a checkpoint of the run left it, and keep checkpoints on the way.

    A periodic checkpoint is written once a step from it has gone well: a diverging training keeps its last good one.
    SIGINT and SIGTERM are heeded between two steps, or within a long one, once a checkpoint is written.

    Raises:
        DivergenceError: See :meth:`Stepwise.step`.
        Interruption: A signal asked for it.
        InputError: The checkpoint is not one of such a training.
    """
    checkpoints = run.checkpoints
    if checkpoints is None:
        while training.step():
            pass
        return
    if checkpoints.begin(training):
        return
    with deferred():
        while not asked():
            state = checkpoints.packed(training) if checkpoints.due() else None
            going = _long_step(training, checkpoints) if training.long_steps else training.step()
            if state is not None:
                checkpoints.write(state)
            if not going:
                checkpoints.end(training)
                return
        checkpoints.write(checkpoints.packed(training))


def _long_step(training: Stepwise, checkpoints: Checkpoints) -> bool:
    """A step that a signal may break off; what is kept is then what was there before it."""
    state, random = deepcopy(training.state_dict()), random_states()
    try:
        with heeded():
            return training.step()
    except Interruption:
        training.load_state_dict(state)
        set_random_states(random)
        checkpoints.write(checkpoints.packed(training))
        raise
