"""A stand-in for network and smoother: results made up from the published values."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import pandas as pd

from pinn_cli.paper.robustness.realisation import Scores
from pinn_cli.report import published
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    from pinn_cli.paper.robustness.realisation import Realisation

# Read once: a study asks for them hundreds of times.
_fitness, _parameters = cache(published.fitness), cache(published.parameters)
SECONDS = {"record": 0.5, "estimate": 1.0, "baseline": 1.0, "total": 2.5}


class FakeSolver:
    """Range fitness is the published value plus 0.2, and 0.1 less with each seed; the smoother's is 0.05 less.

    `diverging` realisations have no rows, `refused` ones raise; `interrupted_after` so many calls the user interrupts.
    """

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.diverging: set[str] = set()
        self.refused: set[str] = set()
        self.interrupted_after: int | None = None

    def __call__(self, one: Realisation) -> Scores:
        if self.interrupted_after is not None and len(self.calls) >= self.interrupted_after:
            raise KeyboardInterrupt
        self.calls.append(one.name)
        if one.name in self.refused:
            raise InputError("system.kappa", -1, ">= 0")
        if one.name in self.diverging:
            return Scores([], [], SECONDS, 3.0, "loss is not finite")
        case = one.name.rpartition("_seed")[0]
        scored = [self._scored(one, case, name, lag) for name, lag in (("pinn", 0.0), ("kalman_smoother", 0.05))]
        fitness, parameters = (pd.concat(tables).to_dict("records") for tables in zip(*scored, strict=True))
        strength = dict(one.columns).get("kappa", 0.0) / 1000.0
        return Scores(fitness, parameters, SECONDS, strength)

    def _scored(self, one: Realisation, case: str, estimator: str, lag: float) -> tuple[pd.DataFrame, pd.DataFrame]:
        cells = _fitness()
        cells = cells.loc[cells["case"] == case, ["group", "quantity", "fitness_percent"]]
        if cells.empty:
            quantities = ["displacement", "velocity", "acceleration", "force"]
            cells = pd.DataFrame({"group": "all", "quantity": quantities, "fitness_percent": 97.0})
        ranged = cells["fitness_percent"] + 0.2 - 0.1 * one.seed - lag
        labels = {"case": case, "estimator": estimator, "seed": one.seed, "model_error": case.partition("_")[0]}
        fitness = cells.assign(**labels, range_fitness_percent=ranged, fitness_percent=ranged - 5.0)
        given = _parameters()
        given = given.loc[given["case"] == case, ["parameter", "true"]]
        estimate = given["true"] * (1.01 + lag)
        error = 100.0 * (estimate / given["true"] - 1.0)
        interval = {"lower_90": estimate * 0.98, "upper_90": estimate * 1.02}
        return fitness, given.assign(**labels, estimate=estimate, error_percent=error, **interval)
