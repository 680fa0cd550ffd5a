"""Trainings that go on step by step, and so can be interrupted and taken up again."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from pinn_cli.interruption import asked, deferred
from pinn_cli.training.estimate import RunContext


class Stepwise(ABC):
    """A training under way: everything that its next step depends on is in its state."""

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
    SIGINT and SIGTERM are heeded between two steps, once a checkpoint is written.

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
            going = training.step()
            if state is not None:
                checkpoints.write(state)
            if not going:
                checkpoints.end(training)
                return
        checkpoints.write(checkpoints.packed(training))
