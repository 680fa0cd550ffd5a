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

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pinn_cli.config import RunConfig
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
    """

    name: str
    estimate: Estimate
    fitness: pd.DataFrame
    parameters: pd.DataFrame

    @classmethod
    def of(cls, config: RunConfig, record: Record, truth: Truth, estimate: Estimate | None) -> Beside | None:
        """Score a baseline's estimate as the network's is; None where there is none."""
        if estimate is None:
            return None
        labels = config.labels(estimator=config.baseline.name)
        fitness = fitness_table(estimate.response, truth.response, record.observed, labels)
        return cls(
            config.baseline.name, estimate, fitness, parameter_table(estimate.parameters, truth.parameters, labels)
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

        Args:
            fitness: The network's, from `pinn_cli.report.fitness.fitness_table`.
            seconds: By stage: ``estimate`` and ``baseline``.
        """
        columns = "".join(f"{heading:>9}" for heading in _HEADINGS)
        lines = [
            f"{'':16}{_TITLES[0]:>36}   {_TITLES[1]:>36}",
            f"{'estimator':<16}{columns}   {columns}{'seconds':>9}",
        ]
        lines.append("-" * len(lines[1]))
        for name, table, stage in (("pinn", fitness, "estimate"), (self.name, self.fitness, "baseline")):
            every = table[table["group"] == "all"].set_index("quantity").loc[list(QUANTITIES), list(FORMULAS)]
            halves = ["".join(f"{_percent(value):>9}" for value in half) for half in every.to_numpy().T]
            taken = f"{seconds[stage]:.1f}" if stage in seconds else "-"
            lines.append(f"{name:<16}{'   '.join(halves)}{taken:>9}")
        return "\n".join(lines)


def stacked(table: pd.DataFrame, below: pd.DataFrame) -> pd.DataFrame:
    """A baseline's rows below the network's; columns that are empty in one of them stay as they are."""
    filled = [part for part in (table, below) if len(part)]
    return pd.concat(filled, ignore_index=True) if filled else table


def _percent(value: float) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.2f}" if abs(value) < 1e4 else f"{value:.0e}"
