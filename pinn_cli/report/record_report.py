"""What is reported of one record; of several that were solved together each has files of its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import pandas as pd

from pinn_cli.record.channels import channels
from pinn_cli.record.response import MEASURED_QUANTITIES
from pinn_cli.report.connection_forces import ConnectionForces
from pinn_cli.report.drift import Drifts, drift_table
from pinn_cli.report.energy import DissipatedEnergy, energy_table
from pinn_cli.report.free_run import FreeRun, free_run, free_run_table
from pinn_cli.report.results import with_labels
from pinn_cli.report.tables import EstimatorTables
from pinn_cli.runs.writing import write_table
from pinn_cli.verdict.judge import judge

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from pinn_cli.report.export.base import Export
    from pinn_cli.report.results import Results
    from pinn_cli.training.estimate import Estimate
    from pinn_cli.verdict.finding import Verdict

COLUMNS = (
    "record", "folder", "samples", "duration_s", "sampling_rate_hz", "sensors", "sigma_discrepancy",
    "largest_nmse_percent", "largest_free_run_nmse_percent", "verdict",
)  # fmt: skip


def record_folder(number: int) -> str:
    """Where the files of a record lie in the run's directory; those of the first lie in the directory itself."""
    return "." if number == 1 else f"record_{number}"


@dataclass(frozen=True, eq=False)
class RecordReport:
    """What is reported of one record, which may be written beside those of others.

    Attributes:
        results: Of it.
        directory: Of its files.
        baseline: Name and estimate of another estimator, where there is one.
        exports: Formats in which the response is written beside ``response.nc``.
    """

    results: Results
    directory: Path
    baseline: tuple[str, Estimate] | None
    exports: Sequence[Export]

    @cached_property
    def free(self) -> FreeRun:
        """The estimated structure's response, left to itself."""
        return free_run(self.results.prescribed, self.results.estimate, self.results.record)

    @cached_property
    def free_table(self) -> pd.DataFrame:
        """How far that is from the estimate."""
        results, labels = self.results, self.results.run.labels_of(estimator="free_run")
        return free_run_table(self.free, results.estimate, results.record, results.truth.response, labels)

    def run_free(self, wanted: bool) -> tuple[FreeRun, pd.DataFrame] | None:
        """Both of these, found now, if anybody wants to see them."""
        found = self.free, self.free_table
        return found if wanted else None

    def verdict(self) -> Verdict | None:
        """None without a problem."""
        problem, other = self.results.problem, self.baseline[1] if self.baseline else None
        if problem is None:
            return None
        return judge(problem, self.results.estimate, other, self.free.response, self.free.agreement)

    @cached_property
    def drifts(self) -> Drifts:
        """Of its connections."""
        return Drifts.of(self.results.prescribed, self.results.estimate, self.results.truth.response)

    @cached_property
    def every_table(self) -> tuple[EstimatorTables, EstimatorTables | None]:
        """The network's tables, and the baseline's."""
        results, named = self.results, self.baseline
        run, record, truth = results.run, results.record, results.truth
        ours = EstimatorTables.of("pinn", run, results.estimate, record, truth, self.free.response)
        return ours, EstimatorTables.of(named[0], run, named[1], record, truth) if named else None

    def tables(self) -> tuple[EstimatorTables, EstimatorTables | None]:
        """These, found now."""
        return self.every_table

    def write(self) -> None:
        """Write its files."""
        # Not above: xarray would be read before anything is printed.
        from pinn_cli.report.dataset import response_dataset, write_dataset

        results, truth, directory = self.results, self.results.truth, self.directory
        estimate, labels = results.estimate, results.run.labels_of(estimator="pinn")
        write_table(self.free_table, directory / "free_run.csv")
        write_table(drift_table(self.drifts, labels), directory / "drift.csv")
        energy = DissipatedEnergy.of(results.prescribed, estimate, truth.response, results.true)
        write_table(energy_table(energy, labels), directory / "energy.csv")
        forces, free = ConnectionForces.of(results.prescribed, estimate, truth), self.free.response
        dataset = response_dataset(
            estimate, results.record, truth.response, labels, free, self.baseline, self.drifts, forces
        )
        write_dataset(dataset, directory / "response.nc")
        for export in self.exports:
            export.write(dataset, directory / f"response.{export.name}")
        ours, theirs = self.every_table
        for name in ("fitness", "residuals"):
            write_table(getattr(ours.above(theirs), name), directory / f"{name}.csv")


def records_table(each: Sequence[tuple[Results, EstimatorTables, Verdict | None]]) -> pd.DataFrame:
    """One row per record: the content of ``records.csv``.

    Args:
        each: Results, tables and verdict of every record.

    Returns:
        Columns: the labels and `COLUMNS`. ``record`` is counted from 1; the NMSE are the largest of any sensor, see
        :func:`pinn_cli.report.residuals.residual_table`; ``verdict`` is that of the record alone.
    """
    rows = []
    for number, (results, tables, verdict) in enumerate(each, start=1):
        record, residuals = results.record, tables.residuals
        largest = residuals[["nmse_percent", "free_run_nmse_percent"]].max()
        counts = len(channels(record, MEASURED_QUANTITIES))
        discrepancy = results.estimate.summary.get("sigma_discrepancy")
        shape = (len(record.time), record.duration, record.sampling_rate, counts, discrepancy)
        rows.append((number, record_folder(number), *shape, *largest, verdict.word if verdict else None))
    return with_labels(pd.DataFrame(rows, columns=list(COLUMNS)), each[0][0].run.labels_of(estimator="pinn"))
