"""The tables that every estimator fills, the network and the baseline alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import pandas as pd

from pinn_cli.report.fitness import fitness_table
from pinn_cli.report.parameters import parameter_table
from pinn_cli.report.residuals import residual_table

if TYPE_CHECKING:
    from pinn_cli.record.record import Record, Response, Truth
    from pinn_cli.report.results import RunDescription
    from pinn_cli.training.estimate import Estimate


@dataclass(frozen=True, eq=False)
class EstimatorTables:
    """The rows of one estimator.

    Attributes:
        name: Of the estimator, ``pinn`` for the network.
        fitness, parameters, residuals: Its rows of the files of these names.
    """

    name: str
    fitness: pd.DataFrame
    parameters: pd.DataFrame
    residuals: pd.DataFrame

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
            residual_table(estimate, record, free_run, labels),
        )

    def above(self, other: EstimatorTables | None) -> EstimatorTables:
        """These rows with those of another estimator below; columns that are empty in one of them stay as they are."""
        if other is None:
            return self
        pairs = ((getattr(self, name), getattr(other, name)) for name in ("fitness", "parameters", "residuals"))
        filled = [([table for table in pair if len(table)], pair[0]) for pair in pairs]
        return EstimatorTables(
            self.name, *(pd.concat(tables, ignore_index=True) if tables else empty for tables, empty in filled)
        )
