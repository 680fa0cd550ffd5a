"""One window: its problem, its solution, the files that it leaves, and what it hands over."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from pinn_cli.model.knowledge import Model
from pinn_cli.record.record import Measurements, Record
from pinn_cli.record.windows import WINDOW_SETTING, Window
from pinn_cli.report.parameters import OVER_TIME, identifiability_warnings, window_rows
from pinn_cli.report.results import Results, RunDescription
from pinn_cli.report.run_record import model_of, observed_digest, write_run_model
from pinn_cli.report.run_report import RecordReport, write_tables
from pinn_cli.runs.stages import Stages
from pinn_cli.runs.writing import write_table
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.scheme import Scheme
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.sweep.windows.store import WindowStore
from pinn_cli.system.quantities import CALIBRATION_UNITS, HIGH_PASS, OF_ONE_CHANNEL
from pinn_cli.system.structure import Structure
from pinn_cli.training.calibrated_record import as_calibrated
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.estimator import Estimator
from pinn_cli.training.whittle.spectral_model import is_spectral
from pinn_cli.verdict.finding import Verdict


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
        return problem.changed(partial(replace, hand_over=window.hand_over)), measured

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
        results = self._results(problem, measured, estimate, before)
        self._leave(window, results, observed_digest([problem.alone.record]), store, stages)

    def _results(
        self, problem: JointProblem, measured: Measurements, estimate: Estimate, before: Model | None
    ) -> Results:
        prescribed = self.prescribed
        if estimate.structure is not None:
            problem = problem.in_coordinates_of(estimate.structure)
            prescribed = prescribed.in_coordinates_of(estimate.structure)
        record = as_calibrated(problem.alone.record, estimate)
        return Results(
            self.run, prescribed, record, measured.truth, estimate, problem=replace(problem.alone, record=record),
            true=self.true if self.simulated else None, model=before or self.model,
        )  # fmt: skip

    def _leave(self, window: Window, results: Results, observed: str, store: WindowStore, stages: Stages) -> None:
        """Write the files of a window; the last one says that it is done."""
        folder, number, estimate = store.folder(window.number), window.number, results.estimate
        # Of every parameter what was prescribed before the first window: name, value, standard deviation.
        uncertain = [] if results.problem is None else results.problem.uncertain
        prescribed = [[parameter.name, parameter.prescribed, parameter.prior_std] for parameter in uncertain]
        beliefs = prescribed if number == 1 else store.entry(1)["beliefs"]
        believed, report = _with_beliefs(results, beliefs), RecordReport(results, folder)
        with stages("verdict"):
            verdict = report.verdict
        with stages("report"):
            report.write()
            (_, parameter_table), *_ = RecordReport(believed, folder).tables
            write_tables(believed, parameter_table, folder)
            rows = window_rows(number + self.earlier, f"window_{number}", estimate)
            write_table(rows, folder / OVER_TIME)
            write_run_model(results, verdict, folder)
        content = {
            **(verdict.record() if verdict else {}),
            "changed": [] if estimate.changes is None else [change.parameter.name for change in estimate.changes.found],
            "training": estimate.summary,
            "observed": observed,
            "step": results.record.step,
            "doubts": list(identifiability_warnings(believed.estimate.parameters, estimate.correlation)),
            **({"beliefs": beliefs} if number == 1 else {}),
        }
        store.conclude(window, _handed_over(results, verdict), content)


def _with_beliefs(results: Results, beliefs: list[list[Any]]) -> Results:
    """The results with what was prescribed before the first window in their tables."""
    given = {name: {"prescribed": value, "prior_std": std} for name, value, std in beliefs}
    parameters = [
        replace(p, parameter=replace(p.parameter, **given.get(p.parameter.name, {})))
        for p in results.estimate.parameters
    ]
    return replace(results, estimate=replace(results.estimate, parameters=parameters))


def _handed_over(results: Results, verdict: Verdict | None) -> Model | None:
    """The model that the next window begins with; None where there is no next one."""
    handed = results.estimate.handed_over
    if handed is None:
        return None
    model = model_of(replace(results, estimate=replace(results.estimate, known=handed.known, end=handed.end)), verdict)
    return replace(model, levels=replace(model.levels, windows=handed.discrepancy))


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
            hint = f"learn it from a part of the record: data.start, data.stop, without {WINDOW_SETTING}"
            raise InputError(setting, "in doubt", f"a number with {WINDOW_SETTING}", hint)
    for channel in problem.record.calibrated:
        if channel.filter_order:
            hint = "each window would begin with another state of its filter"
            raise InputError(
                f"data.channels.{channel.key}.{HIGH_PASS}", "given", f"left out with {WINDOW_SETTING}", hint
            )
