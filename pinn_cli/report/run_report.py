"""Everything that a run leaves behind, and the text that it prints."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from pinn_cli.report.model import write_run_model
from pinn_cli.report.modes import ModeEstimates, mode_table
from pinn_cli.report.over_time import FILE, changes_text, parameters_over_time
from pinn_cli.report.parameters import (
    any_unknown,
    correlation_table,
    identifiability_table,
    parameter_table,
)
from pinn_cli.report.peaks import peak_table, peaks_text
from pinn_cli.report.posterior import diagnostics_table, parameter_estimates, posterior_correlation
from pinn_cli.report.record_report import RecordReport, record_folder, records_table
from pinn_cli.report.run_record import run_record
from pinn_cli.report.stories import stories_text, story_table
from pinn_cli.report.tables import EstimatorTables
from pinn_cli.report.terminal.parameters import diagnostics_text
from pinn_cli.report.terminal.run import run_text
from pinn_cli.report.terminal.validation import validation_text
from pinn_cli.report.validation_run import ValidationRun, validation_table, with_noise_of
from pinn_cli.runs.side_by_side import beside, side_by_side
from pinn_cli.runs.writing import tidy, write_json, write_table
from pinn_cli.verdict.posterior_findings import posterior_findings
from pinn_cli.verdict.records import contradictions, verdict_of_records

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    import pandas as pd

    from pinn_cli.report.export.base import Export
    from pinn_cli.report.free_run import FreeRun
    from pinn_cli.report.results import Results
    from pinn_cli.runs.stages import Stages
    from pinn_cli.training.estimate import Estimate
    from pinn_cli.verdict.finding import Verdict

# Parts that the figures are drawn in, side by side.
_SHARES = 2


@dataclass(frozen=True, eq=False)
class FigureShare:
    """A part of a run's figures, as :func:`pinn_cli.report.figures.write_figures` has it."""

    results: Results
    directory: Path
    part: int = 0
    of: int = 1

    def share_out(self) -> None:
        """Draw all of them, on the cores that there are, which have one matplotlib read for all."""
        import pinn_cli.report.figures  # noqa: F401

        parts = side_by_side([replace(self, part=i, of=_SHARES) for i in range(_SHARES)])
        parts.each(FigureShare.draw)

    def draw(self) -> None:
        """Draw and save them."""
        # Not above: a sweep's jobs draw nothing and have no need of matplotlib.
        from pinn_cli.report import figures

        figures.write_figures(self.results, self.directory, self.part, self.of)


class RunReport:
    """Everything that a run leaves behind: first what it prints, then its files.

    Args:
        results: What came of the run.
        directory: Of the run.
        stages: The seconds so far; the report's own are added.
        exports: Formats in which the response is written beside ``response.nc``.
    """

    def __init__(self, results: Results, directory: Path, stages: Stages, exports: Sequence[Export] = ()) -> None:
        self.results, self.directory, self.stages = _with_posterior(results), directory, stages
        run, other = self.results.run, self.results.baseline
        named = (run.baseline, other) if other else None
        self.reports = [
            RecordReport(own, directory / record_folder(number), named if number == 1 else None, exports)
            for number, own in enumerate(self.results.by_record, start=1)
        ]
        self._drawn: Callable[[], object] | None = None
        self.records = side_by_side(self.reports, [len(report.results.record.time) for report in self.reports])

    @cached_property
    def verdicts(self) -> list[Verdict | None]:
        """Of every record."""
        self.free_run  # noqa: B018  # which it judges, and whose seconds are no verdict's
        with self.stages("verdict"):
            return self.records.each(RecordReport.verdict)

    @cached_property
    def verdict(self) -> Verdict | None:
        """Of all records; None without a problem."""
        results = self.results
        among = contradictions(results.estimate) + posterior_findings(results.posterior)
        return verdict_of_records(self.verdicts, among)

    @cached_property
    def free_run(self) -> tuple[FreeRun, pd.DataFrame]:
        """Of the first record, and its table."""
        with self.stages("free_run"):
            found = self.records.each(RecordReport.run_free, [report is self.reports[0] for report in self.reports])[0]
        assert found is not None
        return found

    @cached_property
    def tables(self) -> tuple[EstimatorTables, EstimatorTables | None, list[EstimatorTables]]:
        """Of the first record, of the baseline, and of further records."""
        with self.stages("report"):
            (tables, baseline), *others = self.records.each(RecordReport.tables)
            labels = self.results.run.labels_of(estimator="pinn")
            parameters = parameter_table(self.results.estimate.parameters, self.results.truth.parameters, labels)
            return replace(tables, parameters=parameters), baseline, [own for own, _ in others]

    @cached_property
    def validation(self) -> tuple[ValidationRun, pd.DataFrame] | None:
        """The identified system on other data, and its table; None without such data."""
        results = self.results
        if results.validation is None:
            return None
        draws = None if results.posterior is None else results.posterior.samples.pooled
        seen, estimate = results.by_record[results.validation.of].record, self._tried
        with self.stages("validation_data"):
            run = ValidationRun.of(results.prescribed, estimate, seen, results.validation, draws, results.run.seed)
            return run, validation_table(run, estimate, results.run.labels_of(estimator="pinn"))

    @property
    def _tried(self) -> Estimate:
        """What is tried on other data: of several records that from which it goes on, and the noise of all sensors."""
        results = self.results
        assert results.validation is not None
        every = [own.estimate for own in results.by_record]
        return with_noise_of(every[results.validation.of], every)

    @cached_property
    def over_time(self) -> pd.DataFrame | None:
        """The parameters from record to record; None unless this record was compared with earlier ones."""
        results = self.results
        if results.model is None:
            return None
        return parameters_over_time(results.model, results.estimate, self.directory.name)

    def text(self) -> str:
        """What the run prints, from `pinn_cli.report.terminal.run.run_text`; the verdict comes last.

        Nothing is written for it, so that nobody waits for files and figures.
        """
        verdict, posterior = self.verdict, self.results.posterior
        tables, baseline, further = self.tables
        diagnostics = "" if posterior is None else diagnostics_text(posterior.diagnostics, posterior.verdict)
        other = "" if self.validation is None else validation_text(*self.validation)
        estimate = self.results.estimate
        paragraphs = (
            stories_text(estimate.stories),
            diagnostics,
            other,
            changes_text(estimate.changes),
            peaks_text(estimate.peaks),
        )
        seconds = self.stages.seconds
        return run_text(self.results, tables, baseline, self.free_run, paragraphs, verdict, seconds, further)

    @contextmanager
    def drawing(self) -> Iterator[None]:
        """Have figures drawn beside what this process does in the block, which is to end with :meth:`write`.

        Where there is no core to spare, or copies of a process do no good, :meth:`write` draws them.
        """
        drawn = beside(FigureShare(self.results, self.directory))
        self._drawn = drawn.begin(FigureShare.share_out)
        try:
            yield
        except BaseException:
            drawn.close()
            tidy(self.directory)
            raise

    def write(self) -> None:
        """Write every file of the run; each is there whole or not at all, and ``run.json`` comes last.

        Figures are those of :meth:`drawing`.
        """
        results, directory = self.results, self.directory
        verdict, (tables, baseline, further) = self.verdict, self.tables
        with self.stages("report"):
            self.records.each(RecordReport.write)
            write_tables(results, tables.above(baseline), directory)
            if further:
                rows = list(zip(results.by_record, (tables, *further), self.verdicts, strict=True))
                write_table(records_table(rows), directory / "records.csv")
            if self.validation is not None:
                write_table(self.validation[1], directory / "validation.csv")
            if self.over_time is not None:
                write_table(self.over_time, directory / FILE)
            if results.estimate.peaks:
                write_table(peak_table(results.estimate.peaks), directory / "peaks.csv")
            else:
                write_run_model(results, verdict, directory)
        if self._drawn is not None:
            with self.stages("figures"):
                if self.validation is not None:
                    _draw_validation(self._tried, self.validation[0], directory)
                if self.over_time is not None:
                    _draw_over_time(self.over_time, directory)
                self._drawn()
        with self.stages("posterior_report"):
            write_posterior(results, directory, self._drawn is not None)
        write_json(run_record(results, verdict, self.stages.seconds), directory / "run.json")


def _with_posterior(results: Results) -> Results:
    """The parameters' means and intervals from their posterior, where there is one."""
    if results.posterior is None:
        return results
    samples = results.posterior.samples
    parameters = parameter_estimates(samples, [found.parameter for found in results.estimate.parameters])
    correlation = posterior_correlation(samples.pooled)

    def sampled(own: Results) -> Results:
        return replace(own, estimate=replace(own.estimate, parameters=parameters, correlation=correlation))

    return replace(sampled(results), further=tuple(map(sampled, results.further)))


def write_tables(results: Results, tables: EstimatorTables, directory: Path) -> None:
    """Write the tables of a run that all its records have in common: parameters, modes, history."""
    estimate, labels = results.estimate, results.run.labels_of(estimator="pinn")
    parameters, correlation = estimate.parameters, estimate.correlation
    files: dict[str, Any] = {"parameters": tables.parameters, "history": estimate.history}
    modes = ModeEstimates.of(results.prescribed, estimate, results.true)
    if modes is not None:
        files["modes"] = mode_table(modes, labels)
    if results.score is not None:
        files["score"] = results.score.table
    if any_unknown(parameters):
        files["identifiability"] = identifiability_table(estimate.before_any_record, correlation, labels)
        if correlation is not None:
            files["correlation"] = correlation_table(parameters, correlation)
    if estimate.stories:
        files["stories"] = story_table(estimate.stories, labels)
    for name, table in files.items():
        write_table(table, directory / f"{name}.csv")


def _draw_validation(estimate: Estimate, run: ValidationRun, directory: Path) -> None:
    from pinn_cli.report.figures import write_validation_figure

    if run.response is not None:
        write_validation_figure(run, estimate, directory / "figures")


def _draw_over_time(table: pd.DataFrame, directory: Path) -> None:
    from pinn_cli.report.figures import write_over_time_figure

    write_over_time_figure(table, directory / "figures")


def write_posterior(results: Results, directory: Path, figures: bool) -> None:
    """Write ``posterior.nc``, ``diagnostics.csv`` and the posterior's figures, where there is a posterior."""
    if results.posterior is None:
        return
    # Not above: xarray would be read before anything is printed.
    from pinn_cli.report.posterior_data import posterior_groups, write_posterior_data

    posterior, labels = results.posterior, results.run.labels_of(estimator="pinn")
    parameters = [found.parameter for found in results.estimate.parameters]
    groups = posterior_groups(posterior, results.record, parameters, labels)
    write_posterior_data(groups, directory / "posterior.nc")
    write_table(diagnostics_table(posterior.diagnostics, labels), directory / "diagnostics.csv")
    if figures:
        from pinn_cli.report.figures import write_posterior_figures

        write_posterior_figures(results, groups, directory / "figures")
