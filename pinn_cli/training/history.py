"""Trainings that go on step by step, and what one went through: losses, weights, the progress bar."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import deepcopy
from types import TracebackType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd
from torch import Tensor
from tqdm import tqdm

from pinn_cli.runs.checkpoint import random_states, set_random_states
from pinn_cli.runs.interruption import Interruption, asked, deferred, heeded
from pinn_cli.training.estimate import RunContext, Watch, unwatched
from pinn_cli.training.noise_model import NoiseModel

if TYPE_CHECKING:
    from pinn_cli.runs.checkpoint import Checkpoints


class History:
    """A row of weighted loss terms and weights every so many iterations, and the progress bar while it is a context.

    Args:
        progress: Whether to draw a progress bar, where there is a terminal.
        watch: Sees every row.
        name: Of the training, on the bar.
        iterations: How many there will be, None where nobody knows.
        every: Iterations from row to row.

    Attributes:
        factorisations: Of normal matrices, where there are any.
    """

    def __init__(
        self,
        progress: bool,
        watch: Watch = unwatched,
        name: str = "gauss-newton",
        iterations: int | None = None,
        every: int = 1,
    ) -> None:
        self.rows: list[dict[str, float]] = []
        self.factorisations = 0
        self.watch, self.every = watch, every
        self.started = time.perf_counter()
        disable = None if progress else True
        self.bar = tqdm(total=iterations, disable=disable, unit="iteration", desc=name, leave=False)

    def __enter__(self) -> History:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, traceback: TracebackType | None) -> None:
        self.bar.close()

    @property
    def seconds(self) -> float:
        """Since training began, those before an interruption included."""
        return time.perf_counter() - self.started

    def add(
        self,
        iteration: int,
        losses: Mapping[str, Tensor | float],
        weights: Mapping[str, float],
        last: bool = False,
        **shown: str,
    ) -> None:
        """Note the weighted loss terms after so many iterations, if a row is due or this is the last one.

        The bar shows what else is given.
        """
        self.bar.update(iteration - self.bar.n)
        if iteration % self.every and not last:
            return
        # Torch warns on the terminal about a tensor that has a graph.
        values = {name: float(x.detach() if isinstance(x, Tensor) else x) for name, x in losses.items()}
        row = {"iteration": iteration, "seconds": self.seconds}
        row.update({f"loss_{name}": value for name, value in values.items()})
        row.update({f"weight_{name}": weight for name, weight in weights.items()})
        self.rows.append(row)
        self.watch(row)
        self.bar.set_postfix(loss=f"{sum(values.values()):.3g}", **shown)

    def add_step(self, losses: Mapping[str, float], noise: NoiseModel) -> None:
        """Note a step under a noise model, whose variances are the weights."""
        weights = noise_weights(noise)
        if not np.isnan(noise.force).all():
            weights["forced"] = 1.0 / (np.nanmean(noise.force) ** 2 + noise.discrepancy**2)
        self.add(len(self.rows) + 1, losses, weights, discrepancy=f"{noise.discrepancy:.2g} N")

    def count(self, factorisations: int) -> None:
        """Add so many to those that there were."""
        self.factorisations += factorisations

    def table(self) -> pd.DataFrame:
        """All rows."""
        return pd.DataFrame(self.rows)

    def state_dict(self) -> dict[str, Any]:
        """Rows and seconds so far."""
        return {"rows": [dict(row) for row in self.rows], "seconds": self.seconds}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from there; whoever watches sees those rows too: a process that was killed may not have told them."""
        self.rows = [dict(row) for row in state["rows"]]
        for row in self.rows:
            self.watch(row)
        self.started = time.perf_counter() - state["seconds"]


def noise_weights(noise: NoiseModel) -> dict[str, float]:
    """Weights of the sensors' quantities and of unforced DOFs."""
    weights = {q: float(1.0 / np.nanmean(s) ** 2) for q, s in noise.response.items() if not np.isnan(s).all()}
    return {**weights, "unforced": 1.0 / noise.discrepancy**2}


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
