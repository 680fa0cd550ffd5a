"""Tables 1 to 6, published values beside ours: one row per cell or parameter and run, and laid out as in the paper."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pinn_cli.paper.runs import TABLES, CaseTable, FinishedRun
from pinn_cli.record.response import QUANTITIES
from pinn_cli.report.sheet import Cell, Row, Sheet, block, mark
from pinn_cli.runs.writing import write_table

FITNESS_COLUMNS = (
    "case", "variant", "group", "quantity", "published", "range_fitness_percent", "difference", "below_published",
    "fitness_percent", "seconds", "process_seconds",
)  # fmt: skip
PAPER_PARAMETER_COLUMNS = (
    "case", "variant", "parameter", "true", "published", "published_error_percent", "published_std", "estimate",
    "error_percent", "larger_error", "std", "lower_90", "upper_90", "truth_inside", "seconds", "process_seconds",
)  # fmt: skip
_Shown = Callable[[Mapping[Any, Any]], Cell]
RUN = ["case", "variant", "seconds", "process_seconds"]

GROUP_TITLES = {
    "all": "All DOFs", "first": "First DOF", "last": "Last DOF", "observed": "Observed DOFs",
    "unobserved": "Unobserved DOFs",
}  # fmt: skip
_MODELS = {"none": "no error", "linear": "linear model", "perturbed": "wrong values"}
_CHAINS = {"duffing": "Duffing", "van_der_pol": "Van der Pol"}
# The columns of Tables 3, 4 and 6.
_CASES = {
    "sp_5dof_snr50": "50 dB", "sp_5dof_snr20": "20 dB", "sp_5dof_snr10": "10 dB", "sp_5dof_van_der_pol": "Van der Pol",
    "sp_5dof_linear": "Linear model", "sp_5dof_perturbed": "Wrong values", "pe_2dof_duffing": "Duffing",
    "pe_2dof_van_der_pol": "Van der Pol",
}  # fmt: skip
_OF_A_CASE = ("True", "Estimate", "Error (%)", "Std")
FITNESS_NOTE = (
    "Fitness in percent by 100 (1 − RMSE / range), the formula behind the published values; rows called printed use "
    "100 (1 − ‖x − x̃‖ / ‖x − x̄‖), the formula that the paper prints. A dash: the true force is zero there."
)
PARAMETER_NOTE = (
    "Errors are 100 |estimate − true| / |true|; std is the posterior standard deviation, which the paper gives for the "
    "Bayesian cases only. k in N/m, c in N s/m, κ in N/m³, μ in N s/m."
)
WRONG_VALUES_NOTE = (
    "Of the 6-DOF chain whose estimator is given wrong values: k in N/m, c in N s/m, κ in N/m³. The true values are "
    "drawn as the authors' code draws them: {agree} of {count} agree with the published ones at two decimals. Below "
    "them is what uncertain parameters and the smoother make of the prescribed values while they estimate the motion, "
    "which the paper does not attempt; there a mark says which of the two is nearer to the truth."
)


@dataclass(frozen=True, eq=False)
class PaperTable:
    """A table to read, its numbers for the CSV file, and the variant that is the product's own choice."""

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

    def write(self, directory: Path) -> None:
        """Write ``table1.csv``, ``.md`` and ``.tex``, each whole or not at all."""
        write_table(self.comparison, directory / f"{self.sheet.name}.csv")
        self.sheet.write(directory)


def paper_tables(runs: Sequence[FinishedRun], tables: Sequence[CaseTable] = TABLES) -> list[PaperTable]:
    """The tables in order; cells of runs that are not there are left out."""
    kinds = {
        "fitness": ("fitness", compare_fitness, fitness_sheet),
        "parameters": ("parameters", compare_parameters, parameter_sheet),
        "perturbed_parameters": ("parameters", compare_wrong_values, wrong_values_sheet),
    }
    made = []
    for table in tables:
        name, compare, lay_out = kinds[table.kind]
        parts = [run.table(name) for run in runs if run.planned.case in table.cases]
        rows = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=RUN)
        rows = rows[rows["variant"].isin([source.name for source in table.sources])]
        comparison = compare(table, rows)
        made.append(PaperTable(lay_out(table, comparison), comparison, table.variants[0].name))
    return made


def compare_fitness(table: CaseTable, run_rows: pd.DataFrame) -> pd.DataFrame:
    """Every published cell beside ours, run by run: `FITNESS_COLUMNS`.

    ``difference`` is ours less the published value, both by the formula of the paper's tables; ``below_published`` is
    decided at the two decimals that the paper prints. ``run_rows`` are rows as `FinishedRun.table` has them.
    """
    if run_rows.empty:
        return pd.DataFrame(columns=list(FITNESS_COLUMNS))
    both = _with_ours(table, run_rows, ["group", "quantity"], {"fitness_percent": "published"})
    both["difference"] = both["range_fitness_percent"] - both["published"]
    both["below_published"] = both["range_fitness_percent"].round(2) < both["published"].round(2)
    return both[list(FITNESS_COLUMNS)]


def compare_parameters(table: CaseTable, run_rows: pd.DataFrame) -> pd.DataFrame:
    """Every published parameter beside ours, run by run: `PAPER_PARAMETER_COLUMNS`.

    ``true`` is the exact value that the record was simulated with, of which the paper prints two decimals.
    ``larger_error`` (than the published one) is decided at two decimals of a per cent; ``truth_inside`` says whether
    the 90 % interval holds the true value and is empty where there is no interval; ``published_std`` is empty where the
    paper gives none. A parameter that a run does not have leaves its cells empty.
    """
    if run_rows.empty:
        return pd.DataFrame(columns=list(PAPER_PARAMETER_COLUMNS))
    given = {"estimate": "published", "error_percent": "published_error_percent", "std": "published_std"}
    both = _with_ours(table, run_rows, ["parameter"], given)
    both["larger_error"] = both["error_percent"].round(2) > both["published_error_percent"].round(2)
    inside = both["true"].between(both["lower_90"], both["upper_90"]).astype(object)
    both["truth_inside"] = inside.where(both[["true", "lower_90", "upper_90"]].notna().all(axis=1), None)
    return both[list(PAPER_PARAMETER_COLUMNS)]


def _with_ours(table: CaseTable, run_rows: pd.DataFrame, keys: list[str], given: Mapping[str, str]) -> pd.DataFrame:
    """The published rows of every run's case, their columns renamed, and by the keys what it found."""
    runs = run_rows[RUN].drop_duplicates().sort_values("case", key=lambda c: c.map(table.cases.index), kind="stable")
    rows = runs.merge(table.values[["case", *keys, *given]].rename(columns=given), on="case")
    wanted = run_rows.drop(columns=["seconds", "process_seconds"])
    return rows.merge(wanted, on=["case", "variant", *keys], how="left", validate="one_to_one")


def compare_wrong_values(table: CaseTable, run_rows: pd.DataFrame) -> pd.DataFrame:
    """Table 1: the wrong values, the true ones as published and as drawn here, and a column of estimates per run.

    Columns are ``parameter, prescribed, published, drawn, difference`` (drawn less published) and the names of the
    variants, in the paper's order.
    """
    both = table.values.rename(columns={"true": "published"})[["parameter", "prescribed", "published"]]
    by_variant = {name: rows.set_index("parameter") for name, rows in run_rows.groupby("variant", sort=False)}
    # The same in every run, of which an estimator knows nothing.
    true_values = next((rows["true"] for rows in by_variant.values()), pd.Series(dtype=float))
    both["drawn"] = both["parameter"].map(true_values)
    both["difference"] = both["drawn"] - both["published"]
    return both.assign(**{str(name): both["parameter"].map(rows["estimate"]) for name, rows in by_variant.items()})


def case_title(published: pd.DataFrame) -> str:
    """A case in a few words, from its published rows: 6 DOFs, Duffing, linear model, 50 dB."""
    case = published.iloc[0]
    system, model = _CHAINS[case["nonlinearity"]], _MODELS[case["model_error"]]
    return f"{case['ndof']} DOFs, {system}, {model}, {case['snr_db']:g} dB"


def fitness_sheet(table: CaseTable, comparison: pd.DataFrame) -> Sheet:
    """Tables 2 and 5: a block of rows per case, groups of DOFs side by side; variants without a run have no row."""
    by_source = {source.source: comparison[comparison["variant"] == source.name] for source in table.sources}
    rows = fitness_rows(
        table, by_source,
        lambda row: Cell(f"{row['fitness_percent']:.2f}"),
        lambda row: Cell.number(x := row["range_fitness_percent"], ".2f", mark(x, row["published"], True)),
        lambda row: Cell.number(row["fitness_percent"], ".2f"),
    )  # fmt: skip
    return Sheet(table.name, table.title, FITNESS_NOTE, ("Case", "Estimate"), fitness_groups(table), rows)


def fitness_groups(table: CaseTable) -> list[tuple[str, Sequence[str]]]:
    """The columns of a sheet of fitness: every quantity of every group of DOFs."""
    return [(GROUP_TITLES[group], QUANTITIES) for group in dict.fromkeys(table.values["group"])]


def fitness_rows(
    table: CaseTable, by_source: Mapping[str, pd.DataFrame], given: _Shown, ranged: _Shown, printed: _Shown
) -> list[Row]:
    """A block per case: the published values, and by either formula what was found by source.

    ``by_source`` has columns ``case``, ``group`` and ``quantity``; the others make cells of a published row and of one
    that was found.
    """
    rows: list[Row] = []
    columns = [(group, quantity) for group in dict.fromkeys(table.values["group"]) for quantity in QUANTITIES]
    for case, published in table.values.groupby("case", sort=False):
        cells, strict = {"published": _by_cell(published, given)}, {}
        for source, of_source in by_source.items():
            of_case = of_source[of_source["case"] == case]
            if len(of_case):
                cells[source] = _by_cell(of_case, ranged)
                strict[f"{source}, printed"] = _by_cell(of_case, printed)
        rows += block(case_title(published), cells | strict, columns)
    return rows


def _by_cell(rows: pd.DataFrame, shown: _Shown) -> dict[Any, Cell]:
    """By group of DOFs and quantity."""
    return {key: shown(row) for key, row in rows.set_index(["group", "quantity"]).to_dict("index").items()}


def parameter_sheet(table: CaseTable, comparison: pd.DataFrame) -> Sheet:
    """Tables 3, 4 and 6: parameters downwards, cases side by side, a row per source that has a run."""
    parameters = {case: list(cells["parameter"]) for case, cells in table.values.groupby("case", sort=False)}
    by_key = comparison.set_index(["case", "variant", "parameter"]).to_dict("index")
    given = table.values.set_index(["case", "parameter"]).to_dict("index")
    rows: list[Row] = []
    for place in range(max(map(len, parameters.values()))):
        names = {case: listed[place] for case, listed in parameters.items() if place < len(listed)}
        cells = {"published": {case: _published(given.get((case, names.get(case)))) for case in parameters}}
        for source in table.sources:
            ours = {case: by_key.get((case, source.name, names.get(case))) for case in parameters}
            if any(ours.values()):
                cells[source.source] = {case: _ours(row) for case, row in ours.items()}
        flat = {
            source: {(case, i): cell for case, column in by_case.items() for i, cell in enumerate(column)}
            for source, by_case in cells.items()
        }
        columns = [(case, i) for case in parameters for i in range(len(_OF_A_CASE))]
        rows += block("/".join(dict.fromkeys(names.values())), flat, columns)
    groups = [(_CASES[str(case)], _OF_A_CASE) for case in parameters]
    judged = comparison.dropna(subset=["truth_inside"]).groupby("variant")["truth_inside"]
    held = judged.agg(["sum", "size"]).to_dict("index")
    counts = [
        f"{s.source}, {held[s.name]['sum']:.0f} of {held[s.name]['size']}" for s in table.sources if s.name in held
    ]
    holding = f" 90 % intervals that hold the true value: {'; '.join(counts)}." if counts else ""
    return Sheet(table.name, table.title, PARAMETER_NOTE + holding, ("Parameter", "Estimate"), groups, rows)


def _published(row: Mapping[Any, Any] | None) -> list[Cell]:
    if row is None:
        return [Cell("")] * len(_OF_A_CASE)
    return [Cell.number(row[name], "g") for name in ("true", "estimate", "error_percent", "std")]


def _ours(row: Mapping[Any, Any] | None) -> list[Cell]:
    if row is None:
        return [Cell("")] * len(_OF_A_CASE)
    sign = mark(row["error_percent"], row["published_error_percent"])
    # To the second digit of its standard deviation.
    decimals = max(1 - math.floor(math.log10(row["std"])), 0) if row["std"] > 0.0 else None
    estimate = Cell.number(row["estimate"], ".5g" if decimals is None else f".{decimals}f")
    return [Cell(""), estimate, Cell.number(row["error_percent"], ".2f", sign), Cell.number(row["std"], ".2g")]


def wrong_values_sheet(table: CaseTable, comparison: pd.DataFrame) -> Sheet:
    """Table 1: a block of rows per kind of parameter, connections side by side."""
    kinds = comparison["parameter"].str.rpartition("_")[0]
    sources = [
        source for source in table.sources if source.name in comparison and comparison[source.name].notna().any()
    ]
    errors = comparison[[source.name for source in sources]].sub(comparison["drawn"], axis=0).abs().round(2)
    count = int(kinds.value_counts().max())
    titles = {"prescribed": "prescribed", "published": "true, published", "drawn": "true, drawn here"}
    titles |= {source.name: f"{source.source}, estimate" for source in sources}
    rows: list[Row] = []
    for kind, of_kind in comparison.groupby(kinds, sort=False):
        cells = {}
        for column, title in titles.items():
            # Nothing is published to compare with: the better of the estimates is marked.
            best = errors.drop(columns=column, errors="ignore").min(axis=1).gt(errors.get(column, np.inf))
            pairs = enumerate(zip(of_kind[column], best[of_kind.index], strict=True))
            cells[title] = {i: Cell.number(value, ".2f", "better" if better else "") for i, (value, better) in pairs}
        rows += block({"kappa": "κ", "mu": "μ"}.get(str(kind), str(kind)), cells, range(count))
    agree = int((comparison["drawn"].round(2) == comparison["published"]).sum())
    note = WRONG_VALUES_NOTE.format(agree=agree, count=int(comparison["drawn"].notna().sum()))
    groups = [("Connection", [str(i) for i in range(1, count + 1)])]
    return Sheet(table.name, table.title, note, ("Parameter", "Value"), groups, rows)
