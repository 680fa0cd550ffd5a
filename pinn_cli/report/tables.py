"""The tables that every estimator fills, the network and the baseline alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import pandas as pd

from pinn_cli.report.fitness import fitness_table
from pinn_cli.report.parameters import parameter_table
from pinn_cli.report.residuals import residual_table

if TYPE_CHECKING:
    from pinn_cli.record.record import Record, Truth
    from pinn_cli.record.response import Response
    from pinn_cli.report.results import RunDescription
    from pinn_cli.training.estimate import Estimate


@dataclass(frozen=True, eq=False)
class EstimatorTables:
    """The rows of one estimator.

    Attributes:
        name: Of the estimator, ``pinn`` for the network.
        fitness, parameters: Its rows of the files of these names.
        find_residuals: Finds those of ``residuals.csv``.
    """

    name: str
    fitness: pd.DataFrame
    parameters: pd.DataFrame
    find_residuals: Callable[[], pd.DataFrame]

    @cached_property
    def residuals(self) -> pd.DataFrame:
        """Its rows of ``residuals.csv``, found when they are asked for: what a simulated record prints has none."""
        return self.find_residuals()

    def __reduce__(self) -> tuple[type[EstimatorTables], tuple[object, ...]]:
        # Between processes goes what was found.
        return type(self), (self.name, self.fitness, self.parameters, Found(self.residuals))

    @classmethod
    def of(
        cls,
        name: str,
        run: RunDescription,
        estimate: Estimate,
        record: Record,
        truth: Truth,
        free_run: Response | None = None,
    ) -> EstimatorTables:
        """Score an estimate against the truth, where it is known, and against the sensors."""
        labels = run.labels_of(name)
        return cls(
            name,
            fitness_table(estimate.response, truth.response, record.observed, labels),
            parameter_table(estimate.parameters, truth.parameters, labels),
            partial(residual_table, estimate, record, free_run, labels),
        )

    def above(self, other: EstimatorTables | None) -> EstimatorTables:
        """These rows with those of another estimator below; columns that are empty in one of them stay as they are."""
        if other is None:
            return self
        return EstimatorTables(
            self.name,
            _joined(self.fitness, other.fitness),
            _joined(self.parameters, other.parameters),
            lambda: _joined(self.residuals, other.residuals),
        )


@dataclass(frozen=True, eq=False)
class Found:
    """A table that is there already."""

    table: pd.DataFrame

    def __call__(self) -> pd.DataFrame:
        """The table."""
        return self.table


def _joined(above: pd.DataFrame, below: pd.DataFrame) -> pd.DataFrame:
    filled = [table for table in (above, below) if len(table)]
    return pd.concat(filled, ignore_index=True) if filled else above
