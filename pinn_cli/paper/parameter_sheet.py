"""Tables 1, 3, 4 and 6: parameters of the paper's cases, published beside ours and the smoother's."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from pinn_cli.paper.cases import SMOOTHER
from pinn_cli.paper.sheet import Cell, Mark, Row, Sheet, mark, number

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

    from pinn_cli.paper.cases import CaseTable

_CASES = {
    "sp_5dof_snr50": "50 dB",
    "sp_5dof_snr20": "20 dB",
    "sp_5dof_snr10": "10 dB",
    "sp_5dof_van_der_pol": "Van der Pol",
    "sp_5dof_linear": "Linear model",
    "sp_5dof_perturbed": "Wrong values",
    "pe_2dof_duffing": "Duffing",
    "pe_2dof_van_der_pol": "Van der Pol",
}
COLUMNS = ("True", "Estimate", "Error (%)", "Std")
NOTE = (
    "Errors are 100 |estimate − true| / |true|; std is the posterior standard deviation, which the paper gives for the "
    "Bayesian cases only. k in N/m, c in N s/m, κ in N/m³, μ in N s/m."
)
WRONG_VALUES_NOTE = (
    "Of the 6-DOF chain whose estimator is given wrong values: k in N/m, c in N s/m, κ in N/m³. The true values are "
    "drawn as the authors' code draws them: {agree} of {count} agree with the published ones at two decimals. Below "
    "them is what uncertain parameters and the smoother make of the prescribed values while they estimate the motion, "
    "which the paper does not attempt; there a mark says which of the two is nearer to the truth."
)


def parameter_sheet(table: CaseTable, comparison: pd.DataFrame) -> Sheet:
    """The paper's layout: parameters downwards, cases side by side, a row per source.

    Args:
        table: With cells of parameters.
        comparison: From `pinn_cli.paper.comparison.compare_parameters`; variants that it lacks have no row.
    """
    published = table.values
    parameters = {case: list(cells["parameter"]) for case, cells in published.groupby("case", sort=False)}
    found = {(row["case"], row["variant"], row["parameter"]): row for row in comparison.to_dict(orient="records")}
    given = {(row["case"], row["parameter"]): row for row in published.to_dict(orient="records")}
    rows: list[Row] = []
    for place in range(max(map(len, parameters.values()))):
        names = {case: listed[place] for case, listed in parameters.items() if place < len(listed)}
        keys = [(case, names.get(case, "")) for case in parameters]
        cells = [cell for key in keys for cell in _published(given.get(key))]
        rows.append(Row(("/".join(dict.fromkeys(names.values())), "published"), tuple(cells), begins=True))
        for source in (*table.variants, SMOOTHER):
            ours = [found.get((case, source.name, name)) for case, name in keys]
            if any(ours):
                rows.append(Row(("", source.source), tuple(cell for row in ours for cell in _ours(row))))
    groups = tuple((_CASES.get(str(case), str(case)), len(COLUMNS)) for case in parameters)
    columns, note = COLUMNS * len(groups), NOTE + _intervals(table, comparison)
    return Sheet(table.name, table.title, note, ("Parameter", "Estimate"), groups, columns, tuple(rows))


def _intervals(table: CaseTable, comparison: pd.DataFrame) -> str:
    """How many intervals hold the truth, as a sentence."""
    judged = comparison[comparison["truth_inside"].notna()]
    counts = [
        f"{source.source}, {int(inside.sum())} of {len(inside)}"
        for source in (*table.variants, SMOOTHER)
        if len(inside := judged.loc[judged["variant"] == source.name, "truth_inside"])
    ]
    return f" 90 % intervals that hold the true value: {'; '.join(counts)}." if counts else ""


def _published(row: Mapping[Any, Any] | None) -> list[Cell]:
    if row is None:
        return [Cell("")] * len(COLUMNS)
    return [number(row[name], "g") for name in ("true", "estimate", "error_percent", "std")]


def _ours(row: Mapping[Any, Any] | None) -> list[Cell]:
    if row is None:
        return [Cell("")] * len(COLUMNS)
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
    sources = [
        source
        for source in (*table.variants, SMOOTHER)
        if source.name in comparison and comparison[source.name].notna().any()
    ]
    rows: list[Row] = []
    for kind, block in comparison.groupby(kinds, sort=False):
        name = {"kappa": "κ", "mu": "μ"}.get(str(kind), str(kind))
        for title, column in (
            ("prescribed", "prescribed"), ("true, published", "published"), ("true, drawn here", "drawn")
        ):  # fmt: skip
            begins = column == "prescribed"
            cells = tuple(number(value, ".2f") for value in block[column])
            rows.append(Row((name if begins else "", title), cells, begins))
        errors = {source.name: (block[source.name] - block["drawn"]).abs().round(2) for source in sources}
        for source in sources:
            signs = [_nearer(errors, source.name, place) for place in block.index]
            cells = tuple(number(value, ".2f", sign) for value, sign in zip(block[source.name], signs, strict=True))
            rows.append(Row(("", f"{source.source}, estimate"), cells))
    count = int(kinds.value_counts().max())
    agree = int((comparison["drawn"].round(2) == comparison["published"]).sum())
    note = WRONG_VALUES_NOTE.format(agree=agree, count=int(comparison["drawn"].notna().sum()))
    columns = tuple(str(i) for i in range(1, count + 1))
    return Sheet(
        table.name, table.title, note, ("Parameter", "Value"), (("Connection", count),), columns, tuple(rows)
    )  # fmt: skip


def _nearer(errors: Mapping[str, pd.Series[float]], name: str, place: Any) -> Mark:
    """Nothing is published to compare with: the better of the estimates is marked."""
    others = [error[place] for other, error in errors.items() if other != name]
    return "better" if others and errors[name][place] < min(others) else ""
