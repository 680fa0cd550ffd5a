"""``report.html``: what a run found, on one page that needs no network: verdict, tables, figures, what to do next."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
from markupsafe import Markup

from pinn_cli.report import text
from pinn_cli.report.estimates import ModeEstimates
from pinn_cli.report.figures.structure import moving_modes
from pinn_cli.report.results import Results
from pinn_cli.report.sheet import Cell, Row, Sheet, render
from pinn_cli.report.text import Column, Scores, Shown
from pinn_cli.runs.identity import package_version
from pinn_cli.runs.writing import write_text
from pinn_cli.verdict.finding import Verdict

if TYPE_CHECKING:
    from pinn_cli.report.free_run import ValidationRun

PAGE_NAME = "report.html"
MEANING = {
    "sound": "Nothing speaks against the estimate.",
    "questionable": "Something speaks against the estimate: read the reasons before you use a number.",
    "failed": "Do not use the numbers: the estimated structure does not do what was measured, or is far off.",
}
# What each figure shows, in the order of the page; others stand behind them.
CAPTIONS = {
    "response": "Motion and force of the DOFs: the estimate with its 95 % band, and what is known beside it",
    "validation": "The identified system on data that no estimator has seen",
    "parameters": "Parameters with their 90 % intervals",
    "parameters_over_time": "Parameters from record to record, or from window to window",
    "correlation": "Which parameters the record cannot tell apart",
    "modes": "Mode shapes, natural frequencies and damping ratios",
    "structure": "The structure as it was understood",
    "drift": "How far the connections are stretched, and the peaks",
    "hysteresis": "Forces of the connections that have a memory, over their elongation",
    "discrepancy": "The force that the model leaves out",
    "frequency_response": "Frequency responses, measured and estimated",
    "residuals": "What the estimate leaves of every sensor",
    "error_map": "Errors, or standard deviations where there is no truth, over time and DOF",
    "history": "Terms of the loss and their weights, by iteration",
    "posterior_pairs": "Distribution of the parameters",
}
IN_PYTHON = "Read all numbers in Python:", "import pinn_cli; result = pinn_cli.load('DIRECTORY')"
PAGE_DOFS = 40  # beyond these the rows of single DOFs are left to fitness.csv

_THREE, _FOUR = (partial(text.number, digits=digits) for digits in (3, 4))
_MODES = {
    "mode": Column("mode", 6),
    "frequency": Column("frequency (Hz)", 12, _FOUR),
    "lower_90": Column("90 % from", 12, _FOUR),
    "upper_90": Column("to", 12, _FOUR),
    "damping_ratio": Column("damping ratio", 12, _THREE),
    "damping_ratio_lower_90": Column("90 % from", 12, _THREE),
    "damping_ratio_upper_90": Column("to", 12, _THREE),
}


@dataclass(frozen=True, eq=False)
class Page:
    """What stands on the page beside the figures, which lie in the run's directory.

    Attributes:
        case: Of the run.
        verdict: Of the run; None: there is none.
        sheets: Its tables.
        warnings: What a reader must know of the parameters, a sentence each.
        steps: What to do next: a sentence, and a command or "".
        moving: Pictures (SVG) of the modes, the lowest first.
    """

    case: str
    verdict: Verdict | None
    sheets: Sequence[Sheet]
    warnings: Sequence[str] = ()
    steps: Sequence[tuple[str, str]] = ()
    moving: Sequence[str] = ()

    def write(self, directory: Path) -> None:
        """Write it, with all figures that lie there."""
        command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
        content = render(
            "run.html", title=f"{self.case}: {self.verdict.word if self.verdict else 'estimate'}", page=self,
            meaning=MEANING, moving=[Markup(picture) for picture in self.moving], figures=figures_in(directory),
            command=command, directory=str(directory), version=package_version("pinn-cli"),
        )  # fmt: skip
        write_text(content, directory / PAGE_NAME)


def run_page(
    results: Results, verdict: Verdict | None, tables: tuple[pd.DataFrame, pd.DataFrame],
    residuals: Sequence[Sequence[pd.DataFrame]], warnings: Sequence[str], tried: ValidationRun | None,
) -> Page:  # fmt: skip
    """Of a run; tables are those of its files, fitness and parameters.

    ``residuals`` are as :func:`pinn_cli.report.text.sensors_text` has them; ``tried`` is the identified system on other
    data.
    """
    fitness, parameters = tables
    modes = ModeEstimates.of(results.prescribed, results.estimate, results.true)
    sheets = [*parameter_sheets(parameters), *fitness_sheets(fitness)]
    sensors = text.sensors_shown(residuals, results.run.baseline)
    if len(sensors.rows):
        sheets.append(sheet_of("sensors", "Sensors", sensors))
    if tried is not None and tried.response is not None:
        sheets.append(sheet_of("validation", "Validation on other data", text.validation_shown(tried)))
    moving: list[str] = []
    if modes is not None:
        note = "Of the estimated structure, linearised about rest; the shapes stand in modes.csv."
        rows = modes.table.head(text.SENSORS_SHOWN)
        sheets.append(sheet_of("modes", "Natural modes", Shown.of(_MODES, rows, note)))
        moving = list(moving_modes(results.prescribed, modes))
    return Page(results.run.case, verdict, sheets, warnings, next_steps(results, verdict), moving)


def figures_in(directory: Path) -> list[tuple[str, Path]]:
    """Caption and file of all figures of a run, those of further records last."""
    figures = []
    folders = [directory, *sorted(directory.glob("record_*"), key=lambda folder: (len(folder.name), folder.name))]
    for folder in folders:
        files = sorted((folder / "figures").glob("*.png"))
        order = {name: i for i, name in enumerate(CAPTIONS)}
        of_record = "" if folder == directory else f"{folder.name.replace('_', ' ')}: "
        files.sort(key=lambda file: (order.get(file.stem, len(order)), file.stem))
        figures += [(of_record + CAPTIONS.get(file.stem, file.stem.replace("_", " ")), file) for file in files]
    return figures


def sheet_of(name: str, title: str, shown: Shown) -> Sheet:
    """A table as it is printed."""
    (first, head), *others = shown.columns.items()
    rows = [
        Row((head.text(row[first]),), tuple(Cell(column.text(row[key])) for key, column in others))
        for row in shown.rows.to_dict(orient="records")
    ]
    groups = [("", [column.title for _, column in others])]
    return Sheet(name, title, " ".join(shown.notes), (head.title,), groups, rows)


def parameter_sheets(parameters: pd.DataFrame) -> list[Sheet]:
    """Of the unknown parameters, and of those that were prescribed."""
    sheets = []
    for columns, rows, left_out in text.parameters_shown(parameters):
        name, note = "prescribed", "What was given, and what the record makes of it."
        if "start" in columns:
            name, note = "unknown", "Identified from the record; start is where the search began."
        named = rows.assign(parameter=rows["parameter"].str.removesuffix(" *"))
        sheets.append(sheet_of(name, f"{name.capitalize()} parameters", Shown.of(columns, named, note, *left_out)))
    return sheets


def fitness_sheets(fitness: pd.DataFrame) -> list[Sheet]:
    """By group of DOFs and quantity, by both formulas; none where there is nothing to compare with."""
    (quantities, scored), _ = Scores.of(fitness, "group").without_single(PAGE_DOFS)
    rows = [Row((name,), tuple(Cell(text.percent(score)) for score in scores.flat)) for name, scores in scored]
    note = "100 is perfect; error: root mean square of the difference. DOF by DOF, then the mean over the DOFs."
    formulas = [(f"1 - error / {what} of the truth (%)", quantities) for what in ("deviation", "range")]
    return [Sheet("fitness", "Fitness", note, ("DOFs",), formulas, rows)] if rows else []


def next_steps(results: Results, verdict: Verdict | None) -> list[tuple[str, str]]:
    """What a reader may do with such a run: a sentence each, and a command or ""."""
    measured, unknown = not results.run.simulated, [p.name for p in results.estimate.parameters if p.unknown]
    steps = []
    if verdict is not None and not verdict.sound:
        steps.append(("Mend what the first reason names, and run the same command again.", ""))
    if measured and results.validation is None and verdict is not None:
        time = results.record.time
        last = f"'data.validation={{start: {time[0] + 0.8 * (time[-1] - time[0]):.4g}}}'"
        steps.append(("Try the identified system on data that it was not identified from: add", last))
    if results.baseline is None and verdict is not None:
        steps.append(("See what another estimator makes of the same record: add", "baseline=kalman_smoother"))
    if measured and (verdict is None or verdict.sound):
        use = "Use what is known of the structure for its next record:" if unknown else "Use it for the next record:"
        steps.append((use, "pinn-run model=DIRECTORY data=csv data.path=next.csv ..."))
        steps.append(("Predict the response to other forces: add", "scheme=predict"))
    if not measured:
        steps.append(("See how far it goes with noise:", "pinn-run --multirun noise.snr_db=50,30,20 'seed=range(5)'"))
    return [*steps, IN_PYTHON]
