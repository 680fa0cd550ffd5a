"""A run by windows: one after the other, each from its folder on the disk, and at the end the whole of them."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from pinn_cli.model.file import NAME as MODEL
from pinn_cli.record.windows import RecordWindows
from pinn_cli.report.export import Export
from pinn_cli.report.parameters import OVER_TIME, history
from pinn_cli.report.run_record import parameters_of, run_facts
from pinn_cli.report.text import fitness_text, parameters_text, verdict_text
from pinn_cli.runs.reading import undamaged
from pinn_cli.runs.resume import RESULT
from pinn_cli.runs.stages import Stages
from pinn_cli.runs.writing import replacing, write_json, write_table
from pinn_cli.sweep.windows.solving import WindowSolver
from pinn_cli.sweep.windows.store import RESPONSE, Piece, WindowStore, join_responses, joined_fitness, stack_tables
from pinn_cli.training.estimate import Watch
from pinn_cli.verdict.finding import WORDS, Finding, Verdict

# Of the last window: it knows what all of them have told.
FINAL = ("parameters.csv", "correlation.csv", "identifiability.csv", "modes.csv", MODEL)
# Of every window.
STACKED = ("residuals.csv", "drift.csv", "energy.csv", "free_run.csv", "history.csv")
WINDOW_COLUMNS = ("window", "start", "hand_over", "stop", "verdict", "changed", "sigma_discrepancy")


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
        """Solve the windows that are not done, and write the whole; the text that is left to print.

        Args:
            stages: Of the run.
            watch: Who looks on.
        """
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
                from pinn_cli.report.figures import write_over_time_figure
                from pinn_cli.report.page import IN_PYTHON, Page, fitness_sheets, parameter_sheets

                write_over_time_figure(pd.read_csv(self.directory / OVER_TIME), self.directory / "figures", "Window")
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
    """The worst of all windows; reasons say in which, and those that several give in the same words are told once.

    Args:
        entries: Of the windows, in their order.
    """
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
