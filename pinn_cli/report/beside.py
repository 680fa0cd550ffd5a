"""The baseline's estimate beside the network's: rows of the tables, variables of the dataset, and a line to print."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr

from pinn_cli.record.record import QUANTITIES, UNITS
from pinn_cli.report.fitness import FORMULAS, fitness_table
from pinn_cli.report.parameters import parameter_table
from pinn_cli.report.residuals import residual_table
from pinn_cli.report.terminal.columns import percent

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pinn_cli.record.record import Record, Truth
    from pinn_cli.training.estimate import Estimate

_HEADINGS = ("displ.", "veloc.", "accel.", "force")
_TITLES = ("mean over DOFs, printed formula (%)", "by range, as in the tables (%)")


@dataclass(frozen=True, eq=False)
class Beside:
    """What a baseline adds to a report.

    Attributes:
        name: Of the baseline.
        estimate: What it found.
        fitness: Its rows of ``fitness.csv``.
        parameters: Its rows of ``parameters.csv``.
        residuals: Its rows of ``residuals.csv``.
    """

    name: str
    estimate: Estimate
    fitness: pd.DataFrame
    parameters: pd.DataFrame
    residuals: pd.DataFrame

    @classmethod
    def of(
        cls, name: str, labels: Mapping[str, object], record: Record, truth: Truth, estimate: Estimate | None
    ) -> Beside | None:
        """Score a baseline's estimate as the network's is, with the labels of its rows; None where there is none."""
        if estimate is None:
            return None
        return cls(
            name,
            estimate,
            fitness_table(estimate.response, truth.response, record.observed, labels),
            parameter_table(estimate.parameters, truth.parameters, labels),
            residual_table(estimate, record, None, labels),
        )

    def variables(self, dataset: xr.Dataset) -> xr.Dataset:
        """The dataset with ``displacement_<name>`` and ``displacement_<name>_std``, and so on for every quantity."""
        kinds = (("", "", self.estimate.response), ("_std", "standard deviation of the ", self.estimate.std))
        return dataset.assign(
            {
                f"{quantity}_{self.name}{suffix}": (
                    ("time", "dof"),
                    getattr(response, quantity),
                    {"long_name": f"{words}{quantity} estimated by {self.name}", "units": UNITS[quantity]},
                )
                for quantity in QUANTITIES
                for suffix, words, response in kinds
            }
        )

    @property
    def record(self) -> dict[str, Any]:
        """The entry of run.json."""
        return {"baseline": {"name": self.name, **self.estimate.summary}}

    def text(self, fitness: pd.DataFrame, seconds: Mapping[str, float]) -> str:
        """Both estimators' fitness over all DOFs and their seconds, in 100 columns.

        Quantities that nobody can score are left out; of a record without any truth the seconds are left.

        Args:
            fitness: The network's, from `pinn_cli.report.fitness.fitness_table`.
            seconds: By stage: ``estimate`` and ``baseline``.
        """
        both = {
            "pinn": (_over_all(fitness), _taken(seconds, "estimate")),
            self.name: (_over_all(self.fitness), _taken(seconds, "baseline")),
        }
        known = np.any([np.isfinite(scores).any(axis=1) for scores, _ in both.values()], axis=0)
        if not known.any():
            return "seconds: " + ", ".join(f"{name} {taken}" for name, (_, taken) in both.items())
        columns = "".join(f"{heading:>9}" for heading in np.array(_HEADINGS)[known])
        lines = [
            f"{'':16}{_TITLES[0]:>36}   {_TITLES[1]:>36}",
            f"{'estimator':<16}{columns:<36}   {columns:<36}{'seconds':>9}",
        ]
        lines.append("-" * len(lines[1]))
        for name, (scores, taken) in both.items():
            halves = [f"{''.join(f'{percent(value):>9}' for value in half):<36}" for half in scores[known].T]
            lines.append(f"{name:<16}{'   '.join(halves)}{taken:>9}")
        return "\n".join(lines)


def _over_all(fitness: pd.DataFrame) -> np.ndarray:
    """(quantities, formulas) of the group of all DOFs."""
    every = fitness[fitness["group"] == "all"].set_index("quantity")
    scores: np.ndarray = every.loc[list(QUANTITIES), list(FORMULAS)].to_numpy()
    return scores


def _taken(seconds: Mapping[str, float], stage: str) -> str:
    return f"{seconds[stage]:.1f}" if stage in seconds else "-"


def stacked(table: pd.DataFrame, below: pd.DataFrame) -> pd.DataFrame:
    """A baseline's rows below the network's; columns that are empty in one of them stay as they are."""
    filled = [part for part in (table, below) if len(part)]
    return pd.concat(filled, ignore_index=True) if filled else table
