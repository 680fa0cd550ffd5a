"""One window: its problem, its solution, the files that it leaves, and what it hands over."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from pinn_cli.model.model import Model
from pinn_cli.record.record import Measurements, Record
from pinn_cli.record.windows import Window
from pinn_cli.report.model import model_of, write_run_model
from pinn_cli.report.parameters import OVER_TIME, identifiability_warnings, window_rows
from pinn_cli.report.results import Results, RunDescription
from pinn_cli.report.run_record import observed_digest
from pinn_cli.report.run_report import RecordReport, write_tables
from pinn_cli.runs.stages import Stages
from pinn_cli.runs.writing import write_table
from pinn_cli.scheme.base import Scheme
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.system.quantities import CALIBRATION_UNITS, HIGH_PASS, OF_ONE_CHANNEL
from pinn_cli.system.structure import Structure
from pinn_cli.training.base import Estimator
from pinn_cli.training.calibrated_record import as_calibrated
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.whittle.spectral_model import is_spectral
from pinn_cli.verdict.finding import Verdict
from pinn_cli.windows.store import WindowStore

SETTING = "data.window"


@dataclass(frozen=True, eq=False)
class WindowSolver:
    """What all windows of a run have in common.

    Attributes:
        run: Which run it is.
        scheme: What is asked.
        first, later: What solves the first window, and those that go on.
        true: The structure that a simulated record comes from.
        prescribed: The model that the estimator is given.
        measure: From a window to what was measured in it.
        observe: What of that the estimator may see.
        simulated: Whether the truth is known.
        model: What the run began with; None: no earlier run.
        context: What estimators are given.
        earlier: How many records there were before, of which the model knows.
    """

    run: RunDescription
    scheme: Scheme
    first: Estimator
    later: Estimator
    true: Structure
    prescribed: Structure
    measure: Callable[[Window], Measurements]
    observe: Callable[[Record], Record]
    simulated: bool
    model: Model | None
    context: RunContext
    earlier: int = 0

    def posed(self, window: Window, before: Model | None) -> tuple[JointProblem, Measurements]:
        """The problem of a window, and what was measured in it.

        Args:
            window: Which.
            before: What the window before handed over; None of the first.

        Raises:
            InputError: It cannot be solved.
        """
        measured = self.measure(window)
        record = self.observe(measured.record)
        if before is None:
            problem = self.scheme.pose(self.prescribed, [record])
        else:
            problem = self.scheme.next_problem(before, record)
            if not _goes_on(problem.alone):
                problem = JointProblem.of(replace(problem.alone, initial_state=None))
        _check_sensors(problem.alone)
        first, *others = (JointProblem.of(replace(start.alone, hand_over=window.hand_over)) for start in problem.starts)
        return replace(first, other_starts=tuple(others)), measured

    def solve(self, window: Window, before: Model | None, store: WindowStore, stages: Stages) -> None:
        """Solve a window and leave all that is known of it in its folder.

        Raises:
            DivergenceError: It cannot be solved.
        """
        try:
            with stages("problem"):
                problem, measured = self.posed(window, before)
            with stages("estimate"):
                estimate = (self.first if before is None else self.later).solve(problem, self.context)
        except (DivergenceError, InputError) as error:
            raise DivergenceError(f"{window.name}: {error}") from error
        if estimate.structure is not None:
            problem = problem.in_coordinates_of(estimate.structure)
        _Report(self, window, problem.alone, measured, estimate, before, store).write(stages)


def _goes_on(problem: Problem) -> bool:
    """Whether the motion goes on from the state that was handed over.

    It does not across a gap, and of a motion under forces that nobody measured spectra say all that is to be known.
    """
    state, record = problem.initial_state, problem.record
    near = state is not None and abs(state.time - float(record.time[0])) < 0.5 * record.step
    return near and not is_spectral(problem)


def _check_sensors(problem: Problem) -> None:
    """Refuse what is one number of all windows, and would be learned in each anew.

    Raises:
        InputError: Naming the channel.
    """
    for parameter in problem.uncertain:
        if parameter.kind in CALIBRATION_UNITS and parameter.kind not in OF_ONE_CHANNEL:
            setting = f"data.channels.{parameter.label}.{parameter.kind}"
            hint = f"learn it from a part of the record: data.start, data.stop, without {SETTING}"
            raise InputError(setting, "in doubt", f"a number with {SETTING}", hint)
    for gauge in problem.record.gauges:
        if gauge.filter_order:
            hint = "each window would begin with another state of its filter"
            raise InputError(f"data.channels.{gauge.name}.{HIGH_PASS}", "given", f"left out with {SETTING}", hint)


@dataclass(frozen=True, eq=False)
class _Report:
    """What is reported of one window."""

    solver: WindowSolver
    window: Window
    problem: Problem
    measured: Measurements
    estimate: Estimate
    before: Model | None
    store: WindowStore

    def write(self, stages: Stages) -> None:
        """Write its files; the last one says that the window is done."""
        folder, results, number = self.store.folder(self.window.number), self._results, self.window.number
        report = RecordReport(results, folder)
        with stages("verdict"):
            verdict = report.verdict
        with stages("report"):
            report.write()
            ours, *_ = RecordReport(self._believed, folder).tables
            write_tables(self._believed, ours, folder)
            rows = window_rows(number + self.solver.earlier, f"window_{number}", self.estimate)
            write_table(rows, folder / OVER_TIME)
            write_run_model(results, verdict, folder)
        self.store.conclude(self.window, self._handed_over(verdict), self._content(verdict))

    def _content(self, verdict: Verdict | None) -> dict[str, object]:
        """What ``window.json`` says."""
        changes, estimate, record = self.estimate.changes, self._believed.estimate, self.problem.record
        return {
            **(verdict.record() if verdict else {}),
            "changed": [] if changes is None else [change.parameter.name for change in changes.found],
            "training": self.estimate.summary,
            "observed": observed_digest([record]),
            "step": record.step,
            "doubts": list(identifiability_warnings(estimate.parameters, estimate.correlation)),
            **({"beliefs": self._beliefs} if self.window.number == 1 else {}),
        }

    def _handed_over(self, verdict: Verdict | None) -> Model | None:
        """The model that the next window begins with; None where there is no next one."""
        handed = self.estimate.handed_over
        if handed is None:
            return None
        own = replace(self.estimate, known=handed.known, end=handed.end)
        model = model_of(replace(self._results, estimate=own), verdict)
        return replace(model, levels=replace(model.levels, windows=handed.discrepancy))

    @cached_property
    def _results(self) -> Results:
        solver = self.solver
        record = as_calibrated(self.problem.record, self.estimate)
        problem = replace(self.problem, record=record)
        true = solver.true if solver.simulated else None
        reduced, prescribed = self.estimate.structure, solver.prescribed
        prescribed = prescribed if reduced is None else prescribed.in_coordinates_of(reduced)
        return Results(
            solver.run, prescribed, record, self.measured.truth, self.estimate, problem=problem, true=true,
            model=self.before or solver.model,
        )  # fmt: skip

    @cached_property
    def _beliefs(self) -> list[list[Any]]:
        """Of every parameter what was prescribed before the first window: name, value, standard deviation."""
        if self.window.number == 1:
            return [[p.name, p.prescribed, p.prior_std] for p in self.problem.uncertain]
        found: list[list[Any]] = self.store.entry(1)["beliefs"]
        return found

    @cached_property
    def _believed(self) -> Results:
        """The results with what was prescribed before the first window in their tables."""
        given = {name: {"prescribed": value, "prior_std": std} for name, value, std in self._beliefs}
        found = [
            replace(one, parameter=replace(one.parameter, **given.get(one.parameter.name, {})))
            for one in self.estimate.parameters
        ]
        return replace(self._results, estimate=replace(self.estimate, parameters=found))
