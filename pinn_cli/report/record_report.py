"""What is reported of one record; of several that were solved together each has files of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from pinn_cli.record.channels import channels
from pinn_cli.record.record import Record, Truth
from pinn_cli.record.response import MEASURED_QUANTITIES, Response
from pinn_cli.report.connections import dissipated_energy, drift_table, drifts, energy_table
from pinn_cli.report.export import Export
from pinn_cli.report.fitness import fitness_table
from pinn_cli.report.free_run import FreeRun, free_run, free_run_table
from pinn_cli.report.parameters import parameter_table
from pinn_cli.report.residuals import residual_table
from pinn_cli.report.results import Results, RunDescription, with_labels
from pinn_cli.runs.writing import write_table
from pinn_cli.training.estimate import Estimate
from pinn_cli.verdict.finding import Verdict
from pinn_cli.verdict.judge import judge

COLUMNS = (
    "record", "folder", "samples", "duration_s", "sampling_rate_hz", "sensors", "sigma_discrepancy",
    "largest_nmse_percent", "largest_free_run_nmse_percent", "verdict",
)  # fmt: skip


def record_folder(number: int) -> str:
    """Where the files of a record lie in the run's directory; those of the first lie in the directory itself."""
    return "." if number == 1 else f"record_{number}"


@dataclass(frozen=True, eq=False)
class EstimatorTables:
    """The rows of one estimator, the network or the baseline, with the labels of its run.

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

    def __getstate__(self) -> dict[str, Any]:
        # Between processes goes what was found.
        return {**self.__dict__, "find_residuals": self.residuals.copy}

    @classmethod
    def of(
        cls, name: str, run: RunDescription, estimate: Estimate, record: Record, truth: Truth,
        free_run: Response | None = None,
    ) -> EstimatorTables:  # fmt: skip
        """Score an estimate against the truth, where it is known, and against the sensors."""
        labels = run.labels_of(name)
        fitness = with_labels(fitness_table(estimate.response, truth.response, record.observed), labels)
        parameters = with_labels(parameter_table(estimate.parameters, truth.parameters), labels)
        return cls(name, fitness, parameters, lambda: with_labels(residual_table(estimate, record, free_run), labels))

    def above(self, other: EstimatorTables | None) -> EstimatorTables:
        """These rows with those of another estimator below; columns that are empty in one of them stay as they are."""
        if other is None:
            return self
        fitness, parameters = _joined(self.fitness, other.fitness), _joined(self.parameters, other.parameters)
        return EstimatorTables(self.name, fitness, parameters, lambda: _joined(self.residuals, other.residuals))


def _joined(above: pd.DataFrame, below: pd.DataFrame) -> pd.DataFrame:
    filled = [table for table in (above, below) if len(table)]
    return pd.concat(filled, ignore_index=True) if filled else above


@dataclass(frozen=True, eq=False)
class RecordReport:
    """What is reported of one record, and written to its directory beside what is reported of others."""

    results: Results
    directory: Path
    exports: Sequence[Export] = ()

    @cached_property
    def free(self) -> FreeRun:
        """The estimated structure's response, left to itself."""
        return free_run(self.results.prescribed, self.results.estimate, self.results.record)

    @cached_property
    def free_table(self) -> pd.DataFrame:
        """How far that is from the estimate, without labels."""
        results = self.results
        return free_run_table(self.free, results.estimate, results.record, results.truth.response)

    def run_free(self, wanted: bool) -> tuple[FreeRun, pd.DataFrame] | None:
        """Both of these, found now, if anybody wants to see them."""
        found = self.free, self.free_table
        return found if wanted else None

    def verdict(self) -> Verdict | None:
        """None without a problem."""
        results = self.results
        if results.problem is None:
            return None
        return judge(results.problem, results.estimate, results.baseline, self.free.response, self.free.agreement)

    @cached_property
    def every_table(self) -> tuple[EstimatorTables, EstimatorTables | None]:
        """The network's tables, and the baseline's."""
        results, run = self.results, self.results.run
        seen = results.record, results.truth
        ours = EstimatorTables.of("pinn", run, results.estimate, *seen, self.free.response)
        other = results.baseline
        return ours, None if other is None else EstimatorTables.of(run.baseline, run, other, *seen)

    def tables(self) -> tuple[EstimatorTables, EstimatorTables | None]:
        """These, found now."""
        return self.every_table

    def write(self) -> None:
        """Write its files."""
        # Not above: xarray would be read before anything is printed.
        from pinn_cli.report.netcdf import response_dataset, write_dataset

        results, directory = self.results, self.directory
        labels, (ours, theirs) = results.run.labels_of(estimator="pinn"), self.every_table
        stretched, both = drifts(results.prescribed, results.estimate, results.truth.response), ours.above(theirs)
        tables = {
            "free_run": with_labels(self.free_table, labels | {"estimator": "free_run"}),
            "drift": with_labels(drift_table(stretched), labels),
            "energy": with_labels(energy_table(dissipated_energy(results)), labels),
            "fitness": both.fitness,
            "residuals": both.residuals,
        }
        for name, table in tables.items():
            write_table(table, directory / f"{name}.csv")
        dataset = response_dataset(results, self.free.response)
        write_dataset(dataset, directory / "response.nc")
        for export in self.exports:
            export.write(dataset, directory / f"response.{export.name}")


def records_table(each: Sequence[tuple[Results, EstimatorTables, Verdict | None]]) -> pd.DataFrame:
    """One row per record, from 1: the content of ``records.csv``, `COLUMNS`.

    The NMSE are the largest of any sensor, see :func:`pinn_cli.report.residuals.residual_table`; ``verdict`` is that of
    the record alone.
    """
    rows = []
    for number, (results, tables, verdict) in enumerate(each, start=1):
        record, discrepancy = results.record, results.estimate.summary.get("sigma_discrepancy")
        largest = tables.residuals[["nmse_percent", "free_run_nmse_percent"]].max()
        counts = len(channels(record, MEASURED_QUANTITIES))
        shape = (len(record.time), record.duration, record.sampling_rate, counts, discrepancy)
        rows.append((number, record_folder(number), *shape, *largest, verdict.word if verdict else None))
    return pd.DataFrame(rows, columns=list(COLUMNS))
