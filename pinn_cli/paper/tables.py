"""The paper's six tables from finished runs, as CSV, Markdown, LaTeX and for the report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pinn_cli.paper.cases import SMOOTHER, TABLES
from pinn_cli.paper.comparison import compare_fitness, compare_parameters, compare_wrong_values
from pinn_cli.paper.fitness_sheet import fitness_sheet
from pinn_cli.paper.parameter_sheet import parameter_sheet, wrong_values_sheet
from pinn_cli.paper.rendering import write_sheets
from pinn_cli.runs.writing import write_table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import pandas as pd

    from pinn_cli.paper.cases import CaseTable
    from pinn_cli.paper.runs import FinishedRun
    from pinn_cli.paper.sheet import Sheet

_KINDS = {
    "fitness": (compare_fitness, fitness_sheet),
    "parameters": (compare_parameters, parameter_sheet),
    "wrong values": (compare_wrong_values, wrong_values_sheet),
}


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

    def worse(self, variant: str) -> tuple[int, int]:
        """How many of a variant's values are worse than the published ones, and of how many."""
        for column in ("below_published", "larger_error"):
            if column in self.comparison:
                ours = self.comparison.loc[self.comparison["variant"] == variant, column]
                return int(ours.sum()), len(ours)
        return 0, 0


def paper_tables(runs: Sequence[FinishedRun], tables: Sequence[CaseTable] = TABLES) -> list[PaperTable]:
    """The tables in order; cells of runs that are not there are left out."""
    scores = [found for run in runs for found in run.scores()]
    made = []
    for table in tables:
        compare, lay_out = _KINDS[table.kind]
        cases, variants = table.cases, {variant.name for variant in (*table.variants, SMOOTHER)}
        kept = [one for one in scores if one.case in cases and one.variant in variants]
        kept.sort(key=lambda one: cases.index(one.case))
        comparison = compare(table.values, kept)
        made.append(PaperTable(lay_out(table, comparison), comparison, table.variants[0].name))
    return made


def write_tables(tables: Sequence[PaperTable], directory: Path) -> None:
    """Write ``table1.csv``, ``.md`` and ``.tex`` to ``table6``; each is there whole or not at all."""
    for table in tables:
        write_table(table.comparison, directory / f"{table.sheet.name}.csv")
    write_sheets([table.sheet for table in tables], directory)
