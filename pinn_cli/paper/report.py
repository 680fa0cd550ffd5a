"""``report.html``: the whole comparison in one file that needs no network; figures; and what falls short."""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from omegaconf import OmegaConf

from pinn_cli.paper.realisations import PINN, ScoredRealisations
from pinn_cli.paper.runs import SMOOTHER, WITH_SMOOTHER, FinishedRun
from pinn_cli.paper.studies import NonlinearityScores, SeedScores, nonlinearity_realisations, seed_realisations
from pinn_cli.paper.tables import GROUP_TITLES, PaperTable, paper_tables
from pinn_cli.report.run_record import package_versions
from pinn_cli.report.sheet import render
from pinn_cli.runs.writing import replacing, write_text

PICTURE_FORMATS = ("png", "svg", "pdf")  # those that a browser shows come first
NEAR = 0.1  # of fitness in percent: as good as the smoother's, for telling noise from a fault


def write_report(runs: Sequence[FinishedRun], failures: Sequence[str], output: Path) -> Path:
    """Write tables, figures and the report of what is there: styles and images are in it, and it loads nothing.

    ``failures`` say what went wrong with other runs. Seeds and nonlinearity are shown where their results lie in the
    folder.
    """
    tables, images = paper_tables(runs), copy_figures(runs, output / "figures")
    seeds = SeedScores.of(ScoredRealisations.read(seed_realisations(), output / "seeds" / "runs"))
    realised = ScoredRealisations.read(nonlinearity_realisations(), output / "nonlinearity" / "runs")
    nonlinearity = NonlinearityScores.of(realised)
    for table in tables:
        table.write(output / "tables")
    for sheet in seeds.sheets:
        sheet.write(output / "seeds")
    text = render(
        "report.html",
        package="pinn_cli.paper",
        runs=runs,
        failures=failures,
        tables=tables,
        images=images,
        seeds=seeds,
        nonlinearity=nonlinearity,
        nonlinearity_image=nonlinearity.draw(output / "nonlinearity"),
        figures=paper_figures(),
        smoother=SMOOTHER.name,
        reached=_reached(seeds),
        identifiable=_identifiable(tables),
        # The cases where the smoother was asked for and found nothing.
        without_smoother=[
            run.planned.case
            for run in runs
            if set(WITH_SMOOTHER) <= set(run.planned.overrides)
            and SMOOTHER.name not in set(run.table("fitness")["variant"])
        ],
        shortfalls=shortfalls(tables, seeds),
        versions=package_versions(),
    )
    return write_text(text, output / "report.html")


@dataclass(frozen=True)
class PaperFigure:
    """One figure of the paper (an entry of ``figures.yaml``).

    Attributes:
        number: In the paper.
        picture: Name of a file, without its ending: of a schematic or of a figure of the run.
        title: A few words, for headings and alternative text.
        caption: Sentences in our own words.
        run: Name of the run that draws it; empty for schematics.
    """

    number: int
    picture: str
    title: str
    caption: str
    run: str = ""

    @property
    def name(self) -> str:
        """Of its files."""
        return f"figure{self.number:02d}"


@cache
def paper_figures() -> tuple[PaperFigure, ...]:
    """All of them, in the paper's order."""
    listed: Any = OmegaConf.load(_shipped("figures.yaml"))
    remarks = {entry.picture: f" {listed.remarks.get(entry.picture, '')}".rstrip() for entry in listed.figures}
    return tuple(PaperFigure(**{**e, "caption": e.caption.strip() + remarks[e.picture]}) for e in listed.figures)


def copy_figures(runs: Sequence[FinishedRun], directory: Path) -> dict[int, Path]:
    """Copy the schematics and the figures of the runs that are there, as ``figure01.svg``, ``figure01.pdf`` and so on.

    To the number of each figure its copy that a browser shows.
    """
    copies: dict[int, Path] = {}
    sources = {run.planned.name: run.directory / "figures" for run in runs} | {"": _shipped("schematics")}
    for figure in paper_figures():
        for ending in PICTURE_FORMATS if figure.run in sources else ():
            picture, copy = sources[figure.run] / f"{figure.picture}.{ending}", directory / f"{figure.name}.{ending}"
            if picture.exists():
                with replacing(copy) as temporary:
                    shutil.copyfile(picture, temporary)
                copies.setdefault(figure.number, copy)
    return copies


def _shipped(name: str) -> Path:
    return Path(str(resources.files("pinn_cli.paper") / name))


def _reached(seeds: SeedScores) -> list[tuple[str, int, int]]:
    """Whose, in how many cells of Tables 2 and 5 the mean is at least the published value, and of how many."""
    if seeds.rows.empty:
        return []
    given = seeds.summary.dropna(subset=["published"])
    good = given["range_fitness_mean"].round(2) >= given["published"].round(2)
    whose = {PINN: "Our", SMOOTHER.name: "The Kalman smoother's"}
    counts = ((text, good[given["estimator"] == name]) for name, text in whose.items())
    return [(text, int(cells.sum()), len(cells)) for text, cells in counts if len(cells)]


def _identifiable(tables: Sequence[PaperTable]) -> dict[Any, Any] | None:
    """The row of kappa_2 at 10 dB with the uncertainty that the run found; None where there is no such run."""
    for table in tables:
        if "larger_error" in table.comparison:
            ours = table.comparison[table.comparison["std"].notna()]
            wanted = {"case": "sp_5dof_snr10", "parameter": "kappa_2", "variant": table.default}
            for row in _where(ours, wanted).to_dict("records"):
                return row
    return None


def _where(rows: pd.DataFrame, wanted: Mapping[str, str]) -> pd.DataFrame:
    """The rows with these values in these columns."""
    return rows[(rows[list(wanted)] == pd.Series(dict(wanted))).all(axis=1)]


class Shortfall(NamedTuple):
    """One value of ours that is worse than the published one."""

    table: str
    cell: str
    published: str
    ours: str
    reason: str


def shortfalls(tables: Sequence[PaperTable], seeds: SeedScores) -> list[Shortfall]:
    """Those of the default variants, in the tables' order; what other draws of the noise say is among the reasons."""
    shortfalls: list[Shortfall] = []
    for table in tables:
        rows, name = table.comparison, table.sheet.name.replace("table", "Table ")
        for column, describe in (("below_published", _of_fitness), ("larger_error", _of_parameter)):
            if column in rows:
                worse = rows[(rows["variant"] == table.default) & rows[column].astype(bool)]
                shortfalls += [Shortfall(name, *describe(row, rows, seeds)) for row in worse.to_dict(orient="records")]
    return shortfalls


def _of_fitness(row: dict[Any, Any], rows: pd.DataFrame, seeds: SeedScores) -> tuple[str, str, str, str]:
    """All but the table's name."""
    key = {name: row[name] for name in ("case", "group", "quantity")}
    of_smoother = _where(rows, {**key, "variant": SMOOTHER.name})["range_fitness_percent"]
    reason = fitness_reason(row["range_fitness_percent"], float(next(iter(of_smoother), math.nan)))
    reason += over_seeds(seeds.summary, key, "range_fitness_mean", round(row["published"], 2))
    cell = f"{row['case']}, {GROUP_TITLES.get(row['group'], row['group'])}, {row['quantity']}"
    return cell, f"{row['published']:.2f} %", f"{row['range_fitness_percent']:.2f} %", reason


def fitness_reason(ours: float, smoother: float) -> str:
    """Why a range fitness is below, from the smoother's of the same record, in percent; NaN where there is none."""
    if math.isnan(smoother):
        return "No smoother stands beside it, so noise and method cannot be told apart."
    if smoother <= ours + NEAR:
        return f"The smoother reaches {smoother:.2f} % on the same record: no more than the record and the model allow."
    return f"The smoother reaches {smoother:.2f} % on the same record: the shortfall is ours."


def _of_parameter(row: dict[Any, Any], rows: pd.DataFrame, seeds: SeedScores) -> tuple[str, str, str, str]:
    """All but the table's name."""
    published, key = row["published_error_percent"], {name: row[name] for name in ("case", "parameter")}
    others = over_seeds(seeds.parameter_summary, key, "error_percent_mean", -round(published, 2))
    cell, ours = f"{row['case']}, {row['parameter']}", f"{row['error_percent']:.2f} % off"
    return cell, f"{published:g} % off", ours, parameter_reason(row) + others


def parameter_reason(row: dict[Any, Any]) -> str:
    """Why an error is larger, from the estimate's own uncertainty; ``row`` is one of `compare_parameters`."""
    if row["case"].endswith("_linear"):
        return (
            "A linear model has no true stiffness to find: what fits best is the equivalent stiffness, the linear one "
            "plus what the cubic spring adds at the amplitudes of this record."
        )
    spread = f"its standard deviation is {100.0 * row['std'] / abs(row['true']):.2g} % of the true value"
    if row["parameter"] == "kappa_2" and row["case"].endswith("_snr10"):
        return f"Barely identifiable at 10 dB: {spread}, so that any one estimate, also the published one, is luck."
    if row["truth_inside"] is True:
        return f"One draw of the noise: {spread}, and the 90 % interval holds the truth."
    distance = abs(row["estimate"] - row["true"]) / row["std"] if row["std"] > 0 else float("nan")
    return f"The truth lies outside the 90 % interval, {distance:.1f} standard deviations from the estimate; {spread}."


def over_seeds(summary: pd.DataFrame, key: Mapping[str, str], column: str, wanted: float) -> str:
    """What both estimators make of a cell on average over other draws of the noise; empty where there are none.

    ``key`` are columns and values of the cell in the summary of the seeds, ``column`` has its mean. ``wanted`` is the
    published value where more is better; less the published error where less is better.
    """
    cells = pd.DataFrame() if summary.empty else _where(summary, key).set_index("estimator")
    if PINN not in cells.index:
        return ""
    sign, kind = (1.0, "mean") if wanted > 0 else (-1.0, "mean error")
    ours, smoother = (float(cells[column].get(name, math.nan)) for name in (PINN, SMOOTHER.name))
    said = f" Over {int(cells['seeds'][PINN])} other draws our {kind} is {ours:.2f} %"
    said += f", the smoother's {smoother:.2f} %: " if math.isfinite(smoother) else ": "
    if sign * round(ours, 2) >= wanted:
        return said + "this draw is unlucky, not the method."
    if sign * round(smoother, 2) >= wanted:
        return said + "the smoother shows that the noise allows it."
    return said + "the published value is not reached on average by either."
