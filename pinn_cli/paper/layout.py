"""The paper's tables laid out as there: a block of rows for each case or parameter, published, ours and smoother's."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import pandas as pd

from pinn_cli.paper.cases import SMOOTHER, CaseTable, Variant
from pinn_cli.paper.sheet import DASH, Cell, Row, Sheet, mark, number
from pinn_cli.record.response import QUANTITIES

Columns = Mapping[str, Sequence[str]]  # group of DOFs to quantities

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


def fitness_sheet(table: CaseTable, comparison: pd.DataFrame) -> Sheet:
    """Tables 2 and 5: a block of rows per case, groups of DOFs side by side.

    Args:
        table: With cells of fitness.
        comparison: From `pinn_cli.paper.comparison.compare_fitness`; variants that it lacks have no row.
    """
    columns = dict.fromkeys(dict.fromkeys(table.values["group"]), QUANTITIES)
    rows: list[Row] = []
    for case, published in table.values.groupby("case", sort=False):
        cells = {key: Cell(f"{value:.2f}") for key, value in by_cell(published)["fitness_percent"].items()}
        rows.append(fitness_row(case_title(published), "published", cells, columns))
        printed = []
        for source in _sources(table):
            ours = comparison[(comparison["case"] == case) & (comparison["variant"] == source.name)]
            if len(ours):
                found = by_cell(ours).to_dict("index")
                ranged = {key: _ranged(row["range_fitness_percent"], row["published"]) for key, row in found.items()}
                strict = {key: number(row["fitness_percent"], ".2f") for key, row in found.items()}
                rows.append(fitness_row("", source.source, ranged, columns))
                printed.append(fitness_row("", f"{source.source}, printed", strict, columns))
        rows += printed
    return fitness_table(table.name, table.title, FITNESS_NOTE, columns, rows)


def _sources(table: CaseTable) -> tuple[Variant, ...]:
    return (*table.variants, SMOOTHER)


def _ranged(ours: float, published: float) -> Cell:
    return number(ours, ".2f", mark(ours, published, more_is_better=True))


def by_cell(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows by group of DOFs and quantity."""
    return rows.set_index(["group", "quantity"])


def fitness_row(case: str, estimate: str, cells: Mapping[Any, Cell], columns: Columns) -> Row:
    """One row, dashes where there is no cell; that of a case begins a block, those called printed are secondary."""
    keys = [(group, quantity) for group, quantities in columns.items() for quantity in quantities]
    found = tuple(cells.get(key, Cell(DASH)) for key in keys)
    return Row((case, estimate), found, begins=bool(case), secondary=estimate.endswith(", printed"))


def fitness_table(name: str, title: str, note: str, columns: Columns, rows: Sequence[Row]) -> Sheet:
    """Rows under groups of DOFs and quantities."""
    groups = tuple((GROUP_TITLES.get(group, group), len(quantities)) for group, quantities in columns.items())
    return Sheet(name, title, note, ("Case", "Estimate"), groups, tuple(chain(*columns.values())), tuple(rows))


def case_title(published: pd.DataFrame) -> str:
    """A case in a few words, from its published rows: 6 DOFs, Duffing, linear model, 50 dB."""
    case = published.iloc[0]
    system, model = _CHAINS[case["nonlinearity"]], _MODELS[case["model_error"]]
    return f"{case['ndof']} DOFs, {system}, {model}, {case['snr_db']:g} dB"


def parameter_sheet(table: CaseTable, comparison: pd.DataFrame) -> Sheet:
    """Tables 3, 4 and 6: parameters downwards, cases side by side, a row per source.

    Args:
        table: With cells of parameters.
        comparison: From `pinn_cli.paper.comparison.compare_parameters`; variants that it lacks have no row.
    """
    parameters = {case: list(cells["parameter"]) for case, cells in table.values.groupby("case", sort=False)}
    found = {(row["case"], row["variant"], row["parameter"]): row for row in comparison.to_dict(orient="records")}
    given = {(row["case"], row["parameter"]): row for row in table.values.to_dict(orient="records")}
    rows: list[Row] = []
    for place in range(max(map(len, parameters.values()))):
        names = {case: listed[place] for case, listed in parameters.items() if place < len(listed)}
        keys = [(case, names.get(case, "")) for case in parameters]
        cells = [cell for key in keys for cell in _published(given.get(key))]
        rows.append(Row(("/".join(dict.fromkeys(names.values())), "published"), tuple(cells), begins=True))
        for source in _sources(table):
            ours = [found.get((case, source.name, name)) for case, name in keys]
            if any(ours):
                rows.append(Row(("", source.source), tuple(cell for row in ours for cell in _ours(row))))
    groups = tuple((_CASES[str(case)], len(_OF_A_CASE)) for case in parameters)
    note = PARAMETER_NOTE + _intervals(table, comparison)
    heads, columns = ("Parameter", "Estimate"), _OF_A_CASE * len(groups)
    return Sheet(table.name, table.title, note, heads, groups, columns, tuple(rows))


def _intervals(table: CaseTable, comparison: pd.DataFrame) -> str:
    """How many intervals hold the truth, as a sentence."""
    judged = comparison[comparison["truth_inside"].notna()]
    counts = [
        f"{source.source}, {int(inside.sum())} of {len(inside)}"
        for source in _sources(table)
        if len(inside := judged.loc[judged["variant"] == source.name, "truth_inside"])
    ]
    return f" 90 % intervals that hold the true value: {'; '.join(counts)}." if counts else ""


def _published(row: Mapping[Any, Any] | None) -> list[Cell]:
    if row is None:
        return [Cell("")] * len(_OF_A_CASE)
    return [number(row[name], "g") for name in ("true", "estimate", "error_percent", "std")]


def _ours(row: Mapping[Any, Any] | None) -> list[Cell]:
    if row is None:
        return [Cell("")] * len(_OF_A_CASE)
    sign = mark(row["error_percent"], row["published_error_percent"])
    decimals = max(1 - math.floor(math.log10(row["std"])), 0) if row["std"] > 0.0 else None
    # To the second digit of its standard deviation.
    estimate = number(row["estimate"], ".5g" if decimals is None else f".{decimals}f")
    return [Cell(""), estimate, number(row["error_percent"], ".2f", sign), number(row["std"], ".2g")]


def wrong_values_sheet(table: CaseTable, comparison: pd.DataFrame) -> Sheet:
    """Table 1: a block of rows per kind of parameter, connections side by side.

    Args:
        table: Of the case with wrong values.
        comparison: From `pinn_cli.paper.comparison.compare_wrong_values`; variants that it lacks have no row.
    """
    kinds = comparison["parameter"].str.rpartition("_")[0]
    sources = [one for one in _sources(table) if one.name in comparison and comparison[one.name].notna().any()]
    errors = pd.DataFrame({one.name: (comparison[one.name] - comparison["drawn"]).abs().round(2) for one in sources})
    given = {"prescribed": "prescribed", "published": "true, published", "drawn": "true, drawn here"}
    rows: list[Row] = []
    for kind, block in comparison.groupby(kinds, sort=False):
        name = {"kappa": "κ", "mu": "μ"}.get(str(kind), str(kind))
        for column, title in given.items():
            begins = column == "prescribed"
            rows.append(Row((name if begins else "", title), _numbers(block[column]), begins))
        for source in sources:
            # Nothing is published to compare with: the better of the estimates is marked.
            others = errors.loc[block.index].drop(columns=source.name)
            nearer = (errors.loc[block.index, source.name] < others.min(axis=1)).tolist()
            rows.append(Row(("", f"{source.source}, estimate"), _numbers(block[source.name], nearer)))
    count = int(kinds.value_counts().max())
    agree = int((comparison["drawn"].round(2) == comparison["published"]).sum())
    note = WRONG_VALUES_NOTE.format(agree=agree, count=int(comparison["drawn"].notna().sum()))
    columns, groups = tuple(str(i) for i in range(1, count + 1)), (("Connection", count),)
    return Sheet(table.name, table.title, note, ("Parameter", "Value"), groups, columns, tuple(rows))


def _numbers(values: pd.Series[Any], better: Sequence[bool] = ()) -> tuple[Cell, ...]:
    """Two decimals each, those that are better marked."""
    pairs = zip(values, better or [False] * len(values), strict=True)
    return tuple(number(value, ".2f", "better" if one else "") for value, one in pairs)
