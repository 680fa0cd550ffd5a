"""The paper's six tables from finished runs, as CSV, Markdown, LaTeX and for the report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pinn_cli.paper import sheet_files
from pinn_cli.paper.comparison import compare_fitness
from pinn_cli.paper.fitness_sheet import fitness_sheet
from pinn_cli.paper.parameter_comparison import compare_parameters
from pinn_cli.paper.parameter_sheet import parameter_sheet, perturbed_comparison, perturbed_sheet
from pinn_cli.paper.plan import SMOOTHER, case_tables
from pinn_cli.paper.single_tables import FITNESS_TABLES, UNCERTAIN_AND_FIXED, perturbed_parameters_comparison
from pinn_cli.report import published
from pinn_cli.runs.writing import write_table, write_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import pandas as pd

    from pinn_cli.paper.case_runs import CaseRun
    from pinn_cli.paper.runs import FinishedRun
    from pinn_cli.paper.sheet import Sheet

PERTURBED_CASE = "sr_6dof_perturbed"


@dataclass(frozen=True, eq=False)
class PaperTable:
    """A table to read and its numbers.

    Attributes:
        sheet: Laid out as in the paper.
        comparison: The same, one row per cell or parameter and run, for the CSV file.
        default: Name of the variant that is the product's own choice.
    """

    sheet: Sheet
    comparison: pd.DataFrame
    default: str


def paper_tables(runs: Sequence[FinishedRun]) -> list[PaperTable]:
    """Tables 1 to 6; cells of runs that are not there are left out."""
    estimates = [estimate for run in runs for estimate in run.estimates()]
    return [_table1(estimates), *_case_tables(estimates)]


def _table1(estimates: list[CaseRun]) -> PaperTable:
    default = UNCERTAIN_AND_FIXED[0]
    sources = (default, SMOOTHER)
    names = [source.name for source in sources]
    kept = [run for run in estimates if run.case == PERTURBED_CASE and run.variant in names]
    comparison = perturbed_comparison(perturbed_parameters_comparison(), kept)
    return PaperTable(perturbed_sheet(comparison, sources), comparison, default.name)


def _case_tables(estimates: list[CaseRun]) -> list[PaperTable]:
    made = []
    for table in case_tables():
        of_fitness = table in FITNESS_TABLES
        values = published.fitness() if of_fitness else published.parameters()
        values = values[values["table"] == table.published]
        sources = (*table.variants, SMOOTHER)
        kept = [run for run in estimates if run.case in set(values["case"])]
        comparison = (compare_fitness if of_fitness else compare_parameters)(values, kept)
        sheet = (fitness_sheet if of_fitness else parameter_sheet)(table, values, comparison, sources)
        made.append(PaperTable(sheet, comparison, table.variants[0].name))
    return made


def write_tables(tables: Sequence[PaperTable], directory: Path) -> None:
    """Write ``table1.csv``, ``.md`` and ``.tex`` to ``table6``; each is there whole or not at all."""
    for table in tables:
        write_table(table.comparison, directory / f"{table.sheet.name}.csv")
    write_sheets([table.sheet for table in tables], directory)


def write_sheets(sheets: Sequence[Sheet], directory: Path) -> None:
    """Write each as ``<name>.md`` and ``<name>.tex``."""
    for sheet in sheets:
        write_text(sheet_files.markdown(sheet), directory / f"{sheet.name}.md")
        write_text(sheet_files.latex(sheet), directory / f"{sheet.name}.tex")
