"""Everything that a run leaves behind, and the text that it prints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.report import parameters, published
from pinn_cli.report.export import Export
from pinn_cli.report.fitness import FORMULAS
from pinn_cli.report.free_run import FreeRun
from pinn_cli.report.model import write_run_model
from pinn_cli.report.modes import ModeEstimates, mode_table
from pinn_cli.report.over_time import FILE, parameters_over_time
from pinn_cli.report.record_report import EstimatorTables, RecordReport, record_folder, records_table
from pinn_cli.report.results import Results, with_labels
from pinn_cli.report.run_record import run_record
from pinn_cli.report.terminal import findings, tables
from pinn_cli.report.validation_run import ValidationRun, validation_table, with_noise_of
from pinn_cli.runs.side_by_side import beside, side_by_side
from pinn_cli.runs.stages import Stages
from pinn_cli.runs.writing import tidy, write_json, write_table
from pinn_cli.training.estimate import Estimate, Story
from pinn_cli.verdict.finding import Verdict
from pinn_cli.verdict.parameter_findings import posterior_findings
from pinn_cli.verdict.records import contradictions, verdict_of_records

if TYPE_CHECKING:
    import xarray as xr

# Parts that the figures are drawn in, side by side.
_SHARES = 2
STORY_COLUMNS = (
    "story", "parameter", "estimate", "std", "lower_90", "upper_90", "free_run_nmse_percent", "segments_nmse_percent",
)  # fmt: skip


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

        side_by_side([replace(self, part=i, of=_SHARES) for i in range(_SHARES)]).each(FigureShare.draw)

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
        self.labels = results.run.labels_of(estimator="pinn")
        self.reports = [
            RecordReport(own, directory / record_folder(number), exports)
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
        among = contradictions(self.results.estimate) + posterior_findings(self.results.posterior)
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
            (first, baseline), *others = self.records.each(RecordReport.tables)
            every = parameters.parameter_table(self.results.estimate.parameters, self.results.truth.parameters)
            return replace(first, parameters=with_labels(every, self.labels)), baseline, [own for own, _ in others]

    @cached_property
    def validation(self) -> tuple[ValidationRun, pd.DataFrame] | None:
        """The identified system on other data, and its table; None without such data."""
        results, data = self.results, self.results.validation
        if data is None:
            return None
        draws = None if results.posterior is None else results.posterior.samples.pooled
        with self.stages("validation_data"):
            seen = results.by_record[data.of].record
            run = ValidationRun.of(results.prescribed, self._tried, seen, data, draws, results.run.seed)
            return run, validation_table(run, self._tried)

    @property
    def _tried(self) -> Estimate:
        """What is tried on other data: of several records that from which it goes on, and the noise of all sensors."""
        assert self.results.validation is not None
        every = [own.estimate for own in self.results.by_record]
        return with_noise_of(every[self.results.validation.of], every)

    @cached_property
    def over_time(self) -> pd.DataFrame | None:
        """The parameters from record to record; None unless this record was compared with earlier ones."""
        model = self.results.model
        return None if model is None else parameters_over_time(model, self.results.estimate, self.directory.name)

    def text(self) -> str:
        """All that a run prints, in paragraphs that an empty line parts; the verdict comes last.

        A measured record is described sensor by sensor. Its fitness is printed only where sensors were held out, and
        its free run against the sensors only in their table. Nothing is written for it, so that nobody waits for files
        and figures.
        """
        results, estimate, posterior = self.results, self.results.estimate, self.results.posterior
        verdict, free, (ours, baseline, further) = self.verdict, self.free_run, self.tables
        warnings = parameters.identifiability_warnings(estimate.before_any_record, estimate.correlation)
        scored = bool(np.isfinite(ours.fitness[list(FORMULAS)].to_numpy()).any())
        measured = not results.run.simulated and len(ours.residuals) > 0
        paragraphs = [
            tables.sensors_text([ours, *further], baseline) if measured else "",
            tables.parameters_text(ours.parameters, warnings, baseline),
            tables.fitness_text(ours.fitness, results.record.observed, published.fitness_of(self.labels)),
            tables.free_run_text(*free) if scored else tables.free_run_line(*free),
            findings.stories_text(estimate.stories),
            "" if posterior is None else tables.diagnostics_text(posterior.diagnostics, posterior.verdict),
            "" if self.validation is None else tables.validation_text(*self.validation),
            findings.changes_text(estimate.changes),
            findings.peaks_text(estimate.peaks),
            "" if baseline is None else tables.comparison_text(ours, baseline, self.stages.seconds),
            findings.score_text(results.run.validation, results.score),
            "" if verdict is None else findings.verdict_text(verdict),
        ]
        return "\n\n".join(text for text in paragraphs if text)

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
        results, directory, drawn = self.results, self.directory, self._drawn
        verdict, (ours, baseline, further) = self.verdict, self.tables
        with self.stages("report"):
            self.records.each(RecordReport.write)
            write_tables(results, ours.above(baseline), directory)
            for name, table in self._further_tables([ours, *further]).items():
                write_table(table, directory / name)
            if not results.estimate.peaks:
                write_run_model(results, verdict, directory)
        if drawn is not None:
            with self.stages("figures"):
                self._draw_tables()
                drawn()
        with self.stages("posterior_report"):
            groups = write_posterior(results, directory)
            if drawn is not None and groups:
                from pinn_cli.report.figures import write_posterior_figures

                write_posterior_figures(results, groups, directory / "figures")
        write_json(run_record(results, verdict, self.stages.seconds), directory / "run.json")

    def _further_tables(self, records: Sequence[EstimatorTables]) -> dict[str, pd.DataFrame]:
        """Those that not every run has, by their files: of several records, of other data, of records before."""
        out = {}
        if len(records) > 1:
            rows = list(zip(self.results.by_record, records, self.verdicts, strict=True))
            out["records.csv"] = with_labels(records_table(rows), self.labels)
        if self.validation is not None:
            out["validation.csv"] = with_labels(self.validation[1], self.labels)
        if self.over_time is not None:
            out[FILE] = self.over_time
        if self.results.estimate.peaks:
            out["peaks.csv"] = pd.DataFrame([asdict(peak) for peak in self.results.estimate.peaks])
        return out

    def _draw_tables(self) -> None:
        """Draw what is not drawn of the results alone."""
        from pinn_cli.report.figures import write_over_time_figure
        from pinn_cli.report.figures.sensors import validation_figure
        from pinn_cli.report.figures.style import save

        place = self.directory / "figures"
        if self.validation is not None and self.validation[0].response is not None:
            save(validation_figure(self.validation[0], self._tried), place, "validation")
        if self.over_time is not None:
            write_over_time_figure(self.over_time, place)


def _with_posterior(results: Results) -> Results:
    """The parameters' means and intervals from their posterior, where there is one."""
    if results.posterior is None:
        return results
    samples = results.posterior.samples
    found = parameters.parameter_estimates(samples, [found.parameter for found in results.estimate.parameters])
    correlation = parameters.posterior_correlation(samples.pooled)

    def sampled(own: Results) -> Results:
        return replace(own, estimate=replace(own.estimate, parameters=found, correlation=correlation))

    return replace(sampled(results), further=tuple(map(sampled, results.further)))


def write_tables(results: Results, ours: EstimatorTables, directory: Path) -> None:
    """Write the tables of a run that all its records have in common: parameters, modes, history."""
    estimate, labels = results.estimate, results.run.labels_of(estimator="pinn")
    files = {"parameters": ours.parameters, "history": estimate.history}
    modes = ModeEstimates.of(results.prescribed, estimate, results.true)
    if modes is not None:
        files["modes"] = with_labels(mode_table(modes), labels)
    if results.score is not None:
        files["score"] = results.score.table
    if parameters.any_unknown(estimate.parameters):
        judged = parameters.identifiability_table(estimate.before_any_record, estimate.correlation)
        files["identifiability"] = with_labels(judged, labels)
        if estimate.correlation is not None:
            files["correlation"] = parameters.correlation_table(estimate.parameters, estimate.correlation)
    if estimate.stories:
        files["stories"] = with_labels(story_table(estimate.stories), labels)
    for name, table in files.items():
        write_table(table, directory / f"{name}.csv")


def story_table(stories: Sequence[Story]) -> pd.DataFrame:
    """One row per story of a record and parameter, the story that is reported first (the content of ``stories.csv``).

    The last two of `STORY_COLUMNS` are a story's own, the same for all its parameters.
    """
    rows = [
        (story.name, p.name, p.estimate, p.std, p.lower_90, p.upper_90, story.free_run, story.segments)
        for story in stories
        for p in story.parameters
    ]
    return pd.DataFrame(rows, columns=list(STORY_COLUMNS))


def write_posterior(results: Results, directory: Path) -> dict[str, xr.Dataset]:
    """Write ``posterior.nc`` and ``diagnostics.csv``, where there is a posterior; the groups of the first, or none."""
    if results.posterior is None:
        return {}
    # Not above: xarray would be read before anything is printed.
    from pinn_cli.report.netcdf import posterior_groups, write_posterior_data

    posterior, labels = results.posterior, results.run.labels_of(estimator="pinn")
    drawn = [found.parameter for found in results.estimate.parameters]
    groups = posterior_groups(posterior, results.record, drawn, labels)
    write_posterior_data(groups, directory / "posterior.nc")
    diagnostics = posterior.diagnostics[list(parameters.DIAGNOSTICS)]
    write_table(with_labels(diagnostics, labels), directory / "diagnostics.csv")
    return groups
