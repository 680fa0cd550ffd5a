"""What a gradient method went through: loss terms and weights every so many iterations, and the progress bar."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import pandas as pd
from torch import Tensor
from tqdm import tqdm

from pinn_cli.training.estimate import Watch, unwatched


class History:
    """A row of weighted loss terms and weights every so many iterations and at the end, and the progress bar."""

    def __init__(self, name: str, progress: bool, iterations: int, every: int, watch: Watch = unwatched) -> None:
        self.rows: list[dict[str, float]] = []
        self.watch = watch
        self.iterations, self.every = iterations, every
        self.started = time.perf_counter()
        disable = None if progress else True
        self.bar = tqdm(total=iterations, disable=disable, unit="iteration", desc=name, leave=False)

    @property
    def seconds(self) -> float:
        """Since training began, those before an interruption included."""
        return time.perf_counter() - self.started

    def add(
        self, iteration: int, terms: Mapping[str, Tensor | float], weights: Mapping[str, float], last: bool
    ) -> None:
        """Note the weighted loss terms after so many iterations, if a row is due or this is the last one."""
        self.bar.update(iteration - self.bar.n)
        if iteration % self.every and not last:
            return
        losses = {f"loss_{name}": _number(term) for name, term in terms.items()}
        factors = {f"weight_{name}": weight for name, weight in weights.items()}
        self.rows.append({"iteration": iteration, "seconds": self.seconds, **losses, **factors})
        self.watch(self.rows[-1])
        self.bar.set_postfix({name.removeprefix("loss_"): f"{loss:.2g}" for name, loss in losses.items()})

    def close(self) -> None:
        """Take the bar away."""
        self.bar.close()

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


def _number(term: Tensor | float) -> float:
    # Torch warns on the terminal about a tensor that has a graph.
    return float(term.detach() if isinstance(term, Tensor) else term)
