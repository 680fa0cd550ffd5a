"""What every estimator of a run, the network or the baseline, has in the files that all of them share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pandas as pd

from pinn_cli.record.record import Record, Truth
from pinn_cli.report.fitness import fitness_table
from pinn_cli.report.parameters import parameter_table
from pinn_cli.report.results import RunDescription, with_labels
from pinn_cli.training.estimate import Estimate


@dataclass(frozen=True, eq=False)
class EstimatorTables:
    """The rows of one estimator in ``fitness.csv`` and ``parameters.csv``, with the labels of its run.

    ``name`` is that of the estimator, ``pinn`` for the network.
    """

    name: str
    fitness: pd.DataFrame
    parameters: pd.DataFrame

    @classmethod
    def of(cls, name: str, run: RunDescription, estimate: Estimate, record: Record, truth: Truth) -> EstimatorTables:
        """Score an estimate against the truth, where it is known."""
        labels = run.labels_of(name)
        fitness = with_labels(fitness_table(estimate.response, truth.response, record.observed), labels)
        table = parameter_table(estimate.parameters, truth.parameters)
        return cls(name, fitness, with_labels(table, labels))

    def above(self, other: EstimatorTables | None) -> EstimatorTables:
        """These rows with those of another estimator below."""
        if other is None:
            return self
        return replace(
            self, fitness=below(self.fitness, other.fitness), parameters=below(self.parameters, other.parameters)
        )


def below(*tables: pd.DataFrame) -> pd.DataFrame:
    """Tables one below the other; columns that are empty in one of them stay as they are."""
    return pd.concat([table for table in tables if len(table)] or [tables[0]], ignore_index=True)
