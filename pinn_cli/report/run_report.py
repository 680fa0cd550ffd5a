"""Everything that a run leaves behind, and the text that it prints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.record.channels import channels
from pinn_cli.record.record import Record, Truth
from pinn_cli.record.response import MEASURED_QUANTITIES, Response
from pinn_cli.report import estimates, parameters, text
from pinn_cli.report.export import Export
from pinn_cli.report.fitness import FORMULAS, fitness_table, published_fitness_of, residual_table
from pinn_cli.report.free_run import FreeRun, ValidationRun, free_run, free_run_table, with_noise_of
from pinn_cli.report.results import Results, RunDescription, record_folder, with_labels
from pinn_cli.report.run_record import run_record, write_run_model
from pinn_cli.runs.side_by_side import in_a_copy, side_by_side
from pinn_cli.runs.stages import Stages
from pinn_cli.runs.writing import tidy, write_json, write_table
from pinn_cli.training.calibrated_record import as_run
from pinn_cli.training.estimate import Estimate
from pinn_cli.verdict.finding import Verdict
from pinn_cli.verdict.judge import contradictions, judge, verdict_of_records
from pinn_cli.verdict.parameter_findings import posterior_findings

if TYPE_CHECKING:
    import xarray as xr

# Parts that the figures are drawn in, side by side.
_SHARES = 2


@dataclass(frozen=True, eq=False)
class RecordReport:
    """What is reported of one record, and written to its directory beside what is reported of others."""

    results: Results
    directory: Path
    exports: Sequence[Export] = ()

    @cached_property
    def free_run(self) -> tuple[FreeRun, pd.DataFrame]:
        """The estimated structure's response, left to itself, and how far that is from the estimate, without labels."""
        results = self.results
        record = as_run(results.record, results.estimate)
        run = free_run(results.prescribed, results.estimate, record)
        return run, free_run_table(run, results.estimate, record, results.truth.response)

    @cached_property
    def verdict(self) -> Verdict | None:
        """None without a problem."""
        results, (free, _) = self.results, self.free_run
        if results.problem is None:
            return None
        return judge(results.problem, results.estimate, results.baseline, free.response, free.agreement)

    @cached_property
    def estimators(self) -> list[tuple[str, Estimate, Response | None]]:
        """The network and, where there is one, the baseline: name, estimate, and the free run of what it found."""
        results = self.results
        others = [] if results.baseline is None else [(results.run.baseline, results.baseline, None)]
        return [("pinn", results.estimate, self.free_run[0].response), *others]

    @cached_property
    def tables(self) -> list[tuple[pd.DataFrame, pd.DataFrame]]:
        """The rows of every estimator, see :func:`estimator_tables`."""
        run, record, truth = self.results.run, self.results.record, self.results.truth
        return [estimator_tables(name, run, estimate, record, truth) for name, estimate, _ in self.estimators]

    @cached_property
    def residuals(self) -> list[pd.DataFrame]:
        """The rows of ``residuals.csv`` of every estimator; what a simulated record prints needs none."""
        run, record = self.results.run, self.results.record
        return [
            with_labels(residual_table(estimate, record, free), run.labels_of(name))
            for name, estimate, free in self.estimators
        ]

    def write(self) -> None:
        """Write its files."""
        # Not above: xarray would be read before anything is printed.
        from pinn_cli.report.netcdf import response_dataset, write_dataset

        results, labels = self.results, self.results.run.labels_of(estimator="pinn")
        stretched = estimates.drifts(results.prescribed, results.estimate, results.truth.response)
        tables = {
            "free_run": with_labels(self.free_run[1], labels | {"estimator": "free_run"}),
            "drift": with_labels(estimates.drift_table(stretched), labels),
            "energy": with_labels(estimates.energy_table(estimates.dissipated_energy(results)), labels),
            "fitness": below(*[fitness for fitness, _ in self.tables]),
            "residuals": below(*self.residuals),
        }
        if curves := estimates.restoring_curves(results):
            tables["restoring"] = with_labels(estimates.restoring_table(curves), labels)
        for name, table in tables.items():
            write_table(table, self.directory / f"{name}.csv")
        dataset = response_dataset(results, self.free_run[0].response)
        write_dataset(dataset, self.directory / "response.nc")
        for export in self.exports:
            export.write(dataset, self.directory / f"response.{export.name}")


def draw_figures(drawn: tuple[Results, Path]) -> None:
    """Draw all figures of a run, on the cores that there are, which have one matplotlib read for all."""
    import pinn_cli.report.figures  # noqa: F401

    side_by_side([(*drawn, part, _SHARES) for part in range(_SHARES)]).each(_draw_share)


def _draw_share(share: tuple[Results, Path, int, int]) -> None:
    # Not above: a sweep's jobs draw nothing and have no need of matplotlib.
    from pinn_cli.report import figures

    figures.write_figures(*share)


class RunReport:
    """Everything that a run leaves behind: first what it prints, then its files.

    Its seconds are added to ``stages``; ``exports`` are written beside ``response.nc``.
    """

    def __init__(self, results: Results, directory: Path, stages: Stages, exports: Sequence[Export] = ()) -> None:
        self.results, self.directory, self.stages = _with_posterior(results), directory, stages
        self.labels = results.run.labels_of(estimator="pinn")
        by_record = self.results.by_record
        reports = [
            RecordReport(of_record, directory / record_folder(i), exports)
            for i, of_record in enumerate(by_record, start=1)
        ]
        self._drawn: Callable[[], object] | None = None
        self.records = side_by_side(reports, [len(of_record.record.time) for of_record in by_record])

    @cached_property
    def verdicts(self) -> list[Verdict | None]:
        """Of every record."""
        self.free_run  # noqa: B018  # which it judges, and whose seconds are no verdict's
        with self.stages("verdict"):
            return self.records.each(attrgetter("verdict"))

    @cached_property
    def verdict(self) -> Verdict | None:
        """Of all records; None without a problem."""
        among = contradictions(self.results.estimate) + posterior_findings(self.results.posterior)
        return verdict_of_records(self.verdicts, among)

    @cached_property
    def free_run(self) -> tuple[FreeRun, pd.DataFrame]:
        """Of the first record, and its table."""
        with self.stages("free_run"):
            return self.records.each(attrgetter("free_run"))[0]

    @cached_property
    def tables(self) -> list[tuple[pd.DataFrame, pd.DataFrame]]:
        """Of the first record: the network's, whose parameters are those of all records, and the baseline's."""
        with self.stages("report"):
            (fitness, _), *baseline = self.records.each(attrgetter("tables"))[0]
            table = parameters.parameter_table(self.results.estimate.parameters, self.results.truth.parameters)
            return [(fitness, with_labels(table, self.labels)), *baseline]

    @cached_property
    def residuals(self) -> list[list[pd.DataFrame]]:
        """Of every record, those of every estimator."""
        return self.records.each(attrgetter("residuals"))

    @cached_property
    def validation(self) -> ValidationRun | None:
        """The identified system on other data; None without such data.

        Of several records it is that from which it goes on, and has the noise of all sensors.
        """
        results, data = self.results, self.results.validation
        if data is None:
            return None
        draws = None if results.posterior is None else results.posterior.samples.pooled
        with self.stages("validation_data"):
            seen, found = results.by_record[data.of].record, [of_record.estimate for of_record in results.by_record]
            tried = with_noise_of(found[data.of], found)
            return ValidationRun.of(results.prescribed, tried, seen, data, draws, results.run.seed)

    @cached_property
    def over_time(self) -> pd.DataFrame | None:
        """The parameters from record to record; None unless this record was compared with earlier ones."""
        model, estimate = self.results.model, self.results.estimate
        return None if model is None else parameters.parameters_over_time(model, estimate, self.directory.name)

    def text(self) -> str:
        """All that a run prints, in paragraphs that an empty line parts; the verdict comes last.

        A measured record is described sensor by sensor. Its fitness is printed only where sensors were held out, and
        its free run against the sensors only in their table. Nothing is written for it, so that nobody waits for files
        and figures.
        """
        results, estimate, posterior = self.results, self.results.estimate, self.results.posterior
        verdict, free, ((fitness, parameter_table), *others) = self.verdict, self.free_run, self.tables
        their_fitness, theirs = next(iter(others), (None, None))
        terms = parameter_table["parameter"].isin([p.name for p in estimate.parameters if p.parameter.curve])
        scored = bool(np.isfinite(fitness[list(FORMULAS)].to_numpy()).any())
        paragraphs = [
            "" if results.run.simulated else text.sensors_text(self.residuals, results.run.baseline),
            text.parameters_text(parameter_table[~terms], self._warnings, theirs),
            text.curves_text(int(terms.sum())),
            text.fitness_text(fitness, results.record.observed, published_fitness_of(self.labels)),
            text.free_run_text(*free, results.run.truth_label) if scored else text.free_run_line(*free),
            text.stories_text(estimate.stories),
            "" if posterior is None else text.diagnostics_text(posterior.diagnostics, posterior.verdict),
            "" if self.validation is None else text.validation_text(self.validation),
            text.changes_text(estimate.changes),
            text.peaks_text(estimate.peaks),
            "" if their_fitness is None else text.comparison_text(fitness, their_fitness, self.stages.seconds),
            text.score_text(results.run.validation, results.score),
            "" if verdict is None else text.verdict_text(verdict),
        ]
        return "\n\n".join(paragraph for paragraph in paragraphs if paragraph)

    @contextmanager
    def drawing(self) -> Iterator[None]:
        """Have figures drawn beside what this process does in the block, which is to end with :meth:`write`.

        Where there is no core to spare, or copies of a process do no good, :meth:`write` draws them.
        """
        drawn = in_a_copy((self.results, self.directory))
        self._drawn = drawn.begin(draw_figures)
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
        results, directory, drawn, verdict = self.results, self.directory, self._drawn, self.verdict
        with self.stages("report"):
            self.records.each(RecordReport.write)
            write_tables(results, below(*[table for _, table in self.tables]), directory)
            self._write_further_tables()
        page = None
        if drawn is not None:
            # Not above: who draws nothing has no need of templates.
            from pinn_cli.report.page import run_page

            # All of it but the figures, which are still being drawn.
            page = run_page(results, verdict, self.tables[0], self.residuals, self._warnings, self.validation)
            with self.stages("figures"):
                self._draw_tables()
                drawn()
        with self.stages("posterior_report"):
            groups = write_posterior(results, directory)
            if drawn is not None and groups:
                from pinn_cli.report.figures import write_posterior_figures

                write_posterior_figures(results, groups, directory / "figures")
        if page is not None:
            with self.stages("page"):
                page.write(directory)
        write_json(run_record(results, verdict, self.stages.seconds), directory / "run.json")

    @property
    def _warnings(self) -> list[str]:
        """What a reader must know before trusting the unknown parameters."""
        estimate = self.results.estimate
        return parameters.identifiability_warnings(estimate.before_any_record, estimate.correlation)

    def _write_further_tables(self) -> None:
        """Those that not every run has: of several records, of other data, of records before, of what is predicted."""
        results, directory, peaks = self.results, self.directory, self.results.estimate.peaks
        if results.further:
            rows = zip(results.by_record, [tables[0] for tables in self.residuals], self.verdicts, strict=True)
            write_table(with_labels(records_table(list(rows)), self.labels), directory / "records.csv")
        if self.validation is not None:
            write_table(with_labels(self.validation.table, self.labels), directory / "validation.csv")
        if self.over_time is not None:
            write_table(self.over_time, directory / parameters.OVER_TIME)
        if peaks:
            write_table(pd.DataFrame([asdict(peak) for peak in peaks]), directory / "peaks.csv")
        else:
            write_run_model(results, self.verdict, directory)

    def _draw_tables(self) -> None:
        """Draw what is not drawn of the results alone."""
        from pinn_cli.report.figures.parameters import over_time_figure
        from pinn_cli.report.figures.sensors import validation_figure
        from pinn_cli.report.figures.style import save

        place = self.directory / "figures"
        if self.validation is not None and self.validation.response is not None:
            save(validation_figure(self.validation), place, "validation")
        if self.over_time is not None:
            save(over_time_figure(self.over_time), place, "parameters_over_time")


def estimator_tables(
    name: str, run: RunDescription, estimate: Estimate, record: Record, truth: Truth
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The rows of an estimator in ``fitness.csv`` and in ``parameters.csv``, labelled; the network's name is pinn."""
    fitness = fitness_table(estimate.response, truth.response, record.observed)
    parameter_table = parameters.parameter_table(estimate.parameters, truth.parameters)
    return with_labels(fitness, run.labels_of(name)), with_labels(parameter_table, run.labels_of(name))


def below(*tables: pd.DataFrame) -> pd.DataFrame:
    """Tables one below the other; columns that are empty in one of them stay as they are."""
    return pd.concat([table for table in tables if len(table)] or [tables[0]], ignore_index=True)


def _with_posterior(results: Results) -> Results:
    """The parameters' means and intervals from their posterior, where there is one."""
    if results.posterior is None:
        return results
    samples = results.posterior.samples
    means = parameters.parameter_estimates(samples, [p.parameter for p in results.estimate.parameters])
    correlation = parameters.posterior_correlation(samples.pooled)

    def sampled(of_record: Results) -> Results:
        return replace(of_record, estimate=replace(of_record.estimate, parameters=means, correlation=correlation))

    return replace(sampled(results), further=tuple(map(sampled, results.further)))


def records_table(records: Sequence[tuple[Results, pd.DataFrame, Verdict | None]]) -> pd.DataFrame:
    """One row per record, from 1: the content of ``records.csv``.

    The NMSE are the largest of any sensor, see :func:`pinn_cli.report.fitness.residual_table`, whose rows are given;
    ``verdict`` is that of the record alone.
    """
    rows = []
    for number, (results, residuals, verdict) in enumerate(records, start=1):
        record = results.record
        rows.append({
            "record": number, "folder": record_folder(number), "samples": len(record.time),
            "duration_s": record.duration, "sampling_rate_hz": record.sampling_rate,
            "sensors": len(channels(record, MEASURED_QUANTITIES)),
            "sigma_discrepancy": results.estimate.noise.discrepancy,
            "largest_nmse_percent": residuals["nmse_percent"].max(),
            "largest_free_run_nmse_percent": residuals["free_run_nmse_percent"].max(),
            "verdict": verdict.word if verdict else None,
        })  # fmt: skip
    return pd.DataFrame(rows)


def write_tables(results: Results, parameter_table: pd.DataFrame, directory: Path) -> None:
    """Write the tables of a run that all its records have in common: parameters as they are given, modes, history."""
    estimate, labels = results.estimate, results.run.labels_of(estimator="pinn")
    files = {"parameters": parameter_table, "history": estimate.history}
    modes = estimates.ModeEstimates.of(results.prescribed, estimate, results.true)
    if modes is not None:
        files["modes"] = with_labels(modes.table, labels)
    if results.score is not None:
        files["score"] = results.score.table
    if any(p.unknown for p in estimate.parameters):
        judged = parameters.identifiability_table(estimate.before_any_record, estimate.correlation)
        files["identifiability"] = with_labels(judged, labels)
        if estimate.correlation is not None:
            names = [p.name for p in estimate.parameters]
            matrix = pd.DataFrame(estimate.correlation, index=names, columns=names)
            files["correlation"] = matrix.rename_axis("parameter").reset_index()
    if estimate.stories:
        files["stories"] = with_labels(parameters.story_table(estimate.stories), labels)
    for name, table in files.items():
        write_table(table, directory / f"{name}.csv")


def write_posterior(results: Results, directory: Path) -> dict[str, xr.Dataset]:
    """Write ``posterior.nc`` and ``diagnostics.csv``, where there is a posterior; the groups of the first, or none."""
    if results.posterior is None:
        return {}
    # Not above: xarray would be read before anything is printed.
    import xarray as xr

    from pinn_cli.report.netcdf import posterior_groups, write_dataset

    posterior, labels = results.posterior, results.run.labels_of(estimator="pinn")
    drawn = [p.parameter for p in results.estimate.parameters]
    groups = posterior_groups(posterior, results.record, drawn, labels)
    write_dataset(xr.DataTree.from_dict(groups), directory / "posterior.nc")
    diagnostics = posterior.diagnostics[list(parameters.DIAGNOSTICS)]
    write_table(with_labels(diagnostics, labels), directory / "diagnostics.csv")
    return groups
