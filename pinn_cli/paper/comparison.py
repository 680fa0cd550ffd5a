"""Published values beside ours, one row per cell or parameter and run, and the tables that are made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from pinn_cli.paper.cases import SMOOTHER, TABLES, CaseTable
from pinn_cli.paper.layout import fitness_sheet, parameter_sheet, wrong_values_sheet
from pinn_cli.paper.runs import CaseScores, FinishedRun
from pinn_cli.paper.sheet import Sheet, write_sheets
from pinn_cli.runs.writing import write_table

FITNESS_COLUMNS = (
    "case", "variant", "group", "quantity", "published", "range_fitness_percent", "difference", "below_published",
    "fitness_percent", "seconds", "process_seconds",
)  # fmt: skip
PARAMETER_COLUMNS = (
    "case", "variant", "parameter", "true", "published", "published_error_percent", "published_std", "estimate",
    "error_percent", "larger_error", "std", "lower_90", "upper_90", "truth_inside", "seconds", "process_seconds",
)  # fmt: skip


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
    kinds = {
        "fitness": (compare_fitness, fitness_sheet),
        "parameters": (compare_parameters, parameter_sheet),
        "wrong values": (compare_wrong_values, wrong_values_sheet),
    }
    scores = [found for run in runs for found in run.scores]
    made = []
    for table in tables:
        compare, lay_out = kinds[table.kind]
        cases, variants = table.cases, {variant.name for variant in (*table.variants, SMOOTHER)}
        kept = [one for one in scores if one.case in cases and one.variant in variants]
        comparison = compare(table.values, sorted(kept, key=lambda one: cases.index(one.case)))
        made.append(PaperTable(lay_out(table, comparison), comparison, table.variants[0].name))
    return made


def write_tables(tables: Sequence[PaperTable], directory: Path) -> None:
    """Write ``table1.csv``, ``.md`` and ``.tex`` to ``table6``; each is there whole or not at all."""
    for table in tables:
        write_table(table.comparison, directory / f"{table.sheet.name}.csv")
    write_sheets([table.sheet for table in tables], directory)


def compare_fitness(published: pd.DataFrame, scores: Sequence[CaseScores]) -> pd.DataFrame:
    """Every published cell beside ours, one row per run.

    Args:
        published: Rows of `pinn_cli.report.published.fitness`.
        scores: Of the same cases.

    Returns:
        Columns `FITNESS_COLUMNS`, in the order of ``published``, run by run. ``difference`` is ours less the published
        value, both by the formula of the paper's tables; ``below_published`` is decided at the two decimals that the
        paper prints.
    """
    if not scores:
        return pd.DataFrame(columns=list(FITNESS_COLUMNS))
    given, found = {"fitness_percent": "published"}, ("fitness_percent", "range_fitness_percent")
    table = pd.concat([_beside(published, ours, "fitness", ("group", "quantity"), given, found) for ours in scores])
    table["difference"] = table["range_fitness_percent"] - table["published"]
    table["below_published"] = table["range_fitness_percent"].round(2) < table["published"].round(2)
    return table[list(FITNESS_COLUMNS)].reset_index(drop=True)


def compare_parameters(published: pd.DataFrame, scores: Sequence[CaseScores]) -> pd.DataFrame:
    """Every published parameter beside ours, one row per run.

    Args:
        published: Rows of `pinn_cli.report.published.parameters`.
        scores: Of the same cases.

    Returns:
        Columns `PARAMETER_COLUMNS`, in the order of ``published``, run by run. ``true`` is the exact value that the
        record was simulated with, of which the paper prints two decimals. ``larger_error`` (than the published one) is
        decided at two decimals of a per cent; ``truth_inside`` says whether the 90 % interval holds the true value and
        is empty where there is no interval; ``published_std`` is empty where the paper gives none. A parameter that a
        run does not have leaves its cells empty.
    """
    if not scores:
        return pd.DataFrame(columns=list(PARAMETER_COLUMNS))
    given = {"estimate": "published", "error_percent": "published_error_percent", "std": "published_std"}
    found = ("true", "estimate", "error_percent", "std", "lower_90", "upper_90")
    table = pd.concat([_beside(published, ours, "parameters", ("parameter",), given, found) for ours in scores])
    table["larger_error"] = table["error_percent"].round(2) > table["published_error_percent"].round(2)
    inside = table["true"].between(table["lower_90"], table["upper_90"]).astype(object)
    table["truth_inside"] = inside.where(table[["true", "lower_90", "upper_90"]].notna().all(axis=1), None)
    return table[list(PARAMETER_COLUMNS)].reset_index(drop=True)


def _beside(
    published: pd.DataFrame, ours: CaseScores, table: str, keys: tuple[str, ...], given: Mapping[str, str],
    found: tuple[str, ...],
) -> pd.DataFrame:  # fmt: skip
    """The published rows of a run's case, their columns renamed, and by the keys what it found, with its labels."""
    rows = published.loc[published["case"] == ours.case, [*keys, *given]].rename(columns=given)
    beside = rows.merge(getattr(ours, table)[[*keys, *found]], on=list(keys), how="left", validate="one_to_one")
    return beside.assign(
        case=ours.case, variant=ours.variant, seconds=ours.seconds, process_seconds=ours.process_seconds
    )


def compare_wrong_values(published: pd.DataFrame, scores: Sequence[CaseScores]) -> pd.DataFrame:
    """Table 1: the wrong values, the true ones as published and as drawn here, and a column of estimates per run.

    Args:
        published: `pinn_cli.report.published.perturbed_parameters`.
        scores: Of the case with these values.

    Returns:
        Columns ``parameter, prescribed, published, drawn, difference`` (drawn less published) and the names of the
        variants, in the paper's order.
    """
    table = published.rename(columns={"true": "published"})[["parameter", "prescribed", "published"]]
    # The same in every run, of which an estimator knows nothing.
    known = scores[0].parameters.set_index("parameter")["true"] if scores else pd.Series(dtype=float)
    table["drawn"] = table["parameter"].map(known)
    table["difference"] = table["drawn"] - table["published"]
    for ours in scores:
        table[ours.variant] = table["parameter"].map(ours.parameters.set_index("parameter")["estimate"])
    return table
