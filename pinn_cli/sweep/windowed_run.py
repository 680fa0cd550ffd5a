"""A run by windows: the problem of each, its solution, the files that it leaves, and at last the whole."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from pinn_cli.model.file import NAME as MODEL
from pinn_cli.model.knowledge import Model
from pinn_cli.record.record import Measurements, Record
from pinn_cli.record.windows import WINDOW_SETTING, RecordWindows, Window
from pinn_cli.report.export import Export
from pinn_cli.report.parameters import OVER_TIME, history, identifiability_warnings, window_rows
from pinn_cli.report.results import Results, RunDescription
from pinn_cli.report.run_record import model_of, observed_digest, parameters_of, run_facts, write_run_model
from pinn_cli.report.run_report import RecordReport, write_tables
from pinn_cli.report.text import fitness_text, parameters_text, verdict_text
from pinn_cli.runs.reading import undamaged
from pinn_cli.runs.resume import RESULT
from pinn_cli.runs.stages import Stages
from pinn_cli.runs.writing import replacing, write_json, write_table
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.scheme import Scheme
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.sweep.window_store import RESPONSE, Piece, WindowStore, join_responses, joined_fitness, stack_tables
from pinn_cli.system.basis import in_basis_of
from pinn_cli.system.quantities import CALIBRATION_UNITS, HIGH_PASS, OF_ONE_CHANNEL
from pinn_cli.system.structure import Structure
from pinn_cli.training.calibrated_record import as_calibrated
from pinn_cli.training.estimate import RunContext, Watch
from pinn_cli.training.estimator import Estimator
from pinn_cli.training.whittle.spectral_model import is_spectral
from pinn_cli.verdict.finding import WORDS, Finding, Verdict

# Of the last window: it knows what all of them have told.
FINAL = ("parameters.csv", "correlation.csv", "identifiability.csv", "modes.csv", MODEL)
# Of every window.
STACKED = ("residuals.csv", "drift.csv", "energy.csv", "free_run.csv", "history.csv")
WINDOW_COLUMNS = ("window", "start", "hand_over", "stop", "verdict", "changed", "sigma_discrepancy")


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
        """The problem of a window, and what was measured in it; one that cannot be solved is refused.

        It begins with what the window before handed over; None: it is the first.
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
        """Solve a window and leave all that is known of it in its folder; the last file says that it is done.

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
        prescribed, observed = self.prescribed, observed_digest([problem.alone.record])
        if estimate.structure is not None:
            problem = problem.in_basis_of(estimate.structure)
            prescribed = in_basis_of(prescribed, estimate.structure)
        record = as_calibrated(problem.alone.record, estimate)
        solved = replace(problem.alone, record=record)
        results = Results(
            self.run, prescribed, record, measured.truth, estimate, problem=solved,
            true=self.true if self.simulated else None, model=before or self.model,
        )  # fmt: skip
        folder, number = store.folder(window.number), window.number
        # Of every parameter what was prescribed before the first window: name, value, standard deviation.
        prescribed_values = [[p.name, p.prescribed, p.prior_std] for p in solved.uncertain]
        beliefs = prescribed_values if number == 1 else store.entry(1)["beliefs"]
        believed, report = _with_beliefs(results, beliefs), RecordReport(results, folder)
        with stages("verdict"):
            verdict = report.verdict
        with stages("report"):
            report.write()
            (_, parameter_table), *_ = RecordReport(believed, folder).tables
            write_tables(believed, parameter_table, folder)
            write_table(window_rows(number + self.earlier, f"window_{number}", estimate), folder / OVER_TIME)
            write_run_model(results, verdict, folder)
        content = {
            **(verdict.record() if verdict else {}),
            "changed": [] if estimate.changes is None else [change.parameter.name for change in estimate.changes.found],
            "training": estimate.summary,
            "observed": observed,
            "step": record.step,
            "doubts": list(identifiability_warnings(believed.estimate.parameters, estimate.correlation)),
            **({"beliefs": beliefs} if number == 1 else {}),
        }
        handed = estimate.handed_over
        model = None  # where there is no next window
        if handed is not None:
            known = replace(results, estimate=replace(estimate, known=handed.known, end=handed.end))
            model = model_of(known, verdict)
            model = replace(model, levels=replace(model.levels, windows=handed.discrepancy))
        store.conclude(window, model, content)


def _with_beliefs(results: Results, beliefs: list[list[Any]]) -> Results:
    """The results with what was prescribed before the first window in their tables."""
    given = {name: {"prescribed": value, "prior_std": std} for name, value, std in beliefs}
    parameters = [
        replace(p, parameter=replace(p.parameter, **given.get(p.parameter.name, {})))
        for p in results.estimate.parameters
    ]
    return replace(results, estimate=replace(results.estimate, parameters=parameters))


def _goes_on(problem: Problem) -> bool:
    """Whether the motion goes on from the state that was handed over.

    It does not across a gap, and of a motion under forces that nobody measured spectra say all that is to be known.
    """
    state, record = problem.initial_state, problem.record
    near = state is not None and abs(state.time - float(record.time[0])) < 0.5 * record.step
    return near and not is_spectral(problem)


def _check_sensors(problem: Problem) -> None:
    """Refuse, naming the channel, what is one number of all windows and would be learned in each anew."""
    for parameter in problem.uncertain:
        if parameter.kind in CALIBRATION_UNITS and parameter.kind not in OF_ONE_CHANNEL:
            setting = f"data.channels.{parameter.label}.{parameter.kind}"
            hint = f"learn it from a part of the record: data.start, data.stop, without {WINDOW_SETTING}"
            raise InputError(setting, "in doubt", f"a number with {WINDOW_SETTING}", hint)
    for channel in problem.record.calibrated:
        if channel.filter_order:
            hint = "each window would begin with another state of its filter"
            setting = f"data.channels.{channel.key}.{HIGH_PASS}"
            raise InputError(setting, "given", f"left out with {WINDOW_SETTING}", hint)


@dataclass(frozen=True, eq=False)
class WindowedRun:
    """A run that solves its record window by window.

    Attributes:
        solver: Of every window.
        windows: Of the record.
        directory: Of the run.
        identity: Which run its windows are of.
        goes_on: Whether it goes on with windows that are there.
        exports: Formats in which the response is written beside ``response.nc``.
        drawn: Whether there are figures.
        say: Called with a line for every window.
        follows: Whether the record may still grow when the run has ended.
    """

    solver: WindowSolver
    windows: RecordWindows
    directory: Path
    identity: str
    goes_on: bool
    exports: Sequence[Export]
    drawn: bool
    say: Callable[[str], None]
    follows: bool = False

    @property
    def store(self) -> WindowStore:
        """Its windows on the disk."""
        return WindowStore(self.directory)

    def carry_out(self, stages: Stages, watch: Watch) -> str:
        """Solve the windows that are not done, and write the whole; the text that is left to print."""
        store, solver = self.store, self.solver
        solver = replace(solver, context=replace(solver.context, watch=watch))
        store.begin(self.identity, self.goes_on)
        if self.follows and store.done and store.ends(store.done):
            store.forget(store.done)  # it was what there was left, and more may have come
        for window in self.windows.after(store.done):
            before = store.handed_over(window.number - 1) if window.number > 1 else None
            solver.solve(window, before, store, stages)
            self.say(_line(store.entry(window.number)))
            self._write_tables()
        return self._whole(stages)

    def _write_tables(self) -> None:
        """All that is known so far but for the response, which is joined at the end."""
        store, done = self.store, self.store.done
        folders = [store.folder(number) for number in range(1, done + 1)]
        for name in FINAL:
            if (folders[-1] / name).is_file():
                with replacing(self.directory / name) as temporary:
                    shutil.copyfile(folders[-1] / name, temporary)
        if self.solver.earlier and self.solver.model is not None:  # the parameters over time of the records before
            folders.insert(0, store.folder(0))
            write_table(history(self.solver.model), folders[0] / OVER_TIME)
        stack_tables([folder / OVER_TIME for folder in folders], self.directory / OVER_TIME)
        entries = pd.DataFrame(self._entries()).rename(columns={"number": "window"})
        entries["changed"] = entries["changed"].map(" ".join)
        entries["sigma_discrepancy"] = [training.get("sigma_discrepancy") for training in entries["training"]]
        write_table(entries.reindex(columns=WINDOW_COLUMNS), self.directory / "windows.csv")

    def _entries(self) -> list[dict[str, Any]]:
        """What is known of all windows; the last one hands over to none yet."""
        entries = [self.store.entry(number) for number in range(1, self.store.done + 1)]
        return [*entries[:-1], entries[-1] | {"hand_over": None}]

    def _whole(self, stages: Stages) -> str:
        """Write what is about the whole record; ``run.json`` comes last."""
        entries = self._entries()
        folders = [self.store.folder(entry["number"]) for entry in entries]
        labels, verdict = self.solver.run.labels_of(estimator="pinn"), verdict_of_windows(entries)
        with stages("report"):
            self._write_tables()
            pieces = [Piece(folder, e["hand_over"], e["step"]) for folder, e in zip(folders, entries, strict=True)]
            with undamaged("hydra.run.dir", self.directory):
                join_responses(pieces, self.directory / RESPONSE)
            fitness = joined_fitness(self.directory / RESPONSE, labels)
            write_table(fitness, self.directory / "fitness.csv")
            for name in STACKED:
                stack_tables([folder / name for folder in folders], self.directory / name, "window")
            if self.exports:
                import xarray as xr

                with xr.open_dataset(self.directory / RESPONSE) as data:
                    for export in self.exports:
                        export.write(data, self.directory / f"response.{export.name}")
        parameters = pd.read_csv(self.directory / "parameters.csv")
        with stages("figures"):
            if self.drawn:
                # Not above: matplotlib takes a while, and may not be wanted.
                from pinn_cli.report.figures.parameters import over_time_figure
                from pinn_cli.report.figures.style import save
                from pinn_cli.report.page import IN_PYTHON, Page, fitness_sheets, parameter_sheets

                over_time = over_time_figure(pd.read_csv(self.directory / OVER_TIME), "Window")
                save(over_time, self.directory / "figures", "parameters_over_time")
                sheets = [*parameter_sheets(parameters), *fitness_sheets(fitness)]
                Page(self.solver.run.case, verdict, sheets, entries[-1]["doubts"], [IN_PYTHON]).write(self.directory)
        digest = hashlib.sha256(" ".join(e["observed"] for e in entries).encode()).hexdigest()[:16]
        content = run_facts(self.solver.run, entries[-1]["training"], digest, stages.seconds)
        names = ("number", "start", "hand_over", "stop", "verdict", "reasons", "changed")
        content["windows"] = [{name: entry.get(name) for name in names} for entry in entries]
        content["parameters"] = parameters_of(parameters)
        write_json({**content, **verdict.record()}, self.directory / RESULT)
        texts = (parameters_text(parameters, entries[-1]["doubts"]), fitness_text(fitness), verdict_text(verdict))
        return "\n\n".join(text for text in texts if text)


def verdict_of_windows(entries: Sequence[dict[str, Any]]) -> Verdict:
    """The worst of all windows; reasons say in which, and those that several give in the same words are told once."""
    windows: dict[str, list[dict[str, Any]]] = {}
    for entry in entries:
        for reason in entry.get("reasons", ()):
            windows.setdefault(reason, []).append(entry)
    findings = []
    for text, those in windows.items():
        word = max((entry["verdict"] for entry in those), key=WORDS.index)
        several = f" and {len(those) - 1} more windows" if len(those) > 1 else ""
        where = f"{those[0]['start']:.6g} to {those[0]['stop']:.6g} s{several}"
        findings.append(Finding("window", where, f"{where}: {text}", word))
    word = max((entry.get("verdict", "sound") for entry in entries), key=WORDS.index)
    return Verdict(word, Verdict.of(findings).reasons)


def _line(entry: dict[str, Any]) -> str:
    """What is told when a window is done."""
    changed = f"; changed: {', '.join(entry['changed'])}" if entry["changed"] else ""
    return f"window {entry['number']}, {entry['start']:.6g} to {entry['stop']:.6g} s: {entry.get('verdict')}{changed}"
