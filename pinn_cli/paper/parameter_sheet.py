"""Tables 1, 3, 4 and 6: parameters of the paper's cases, published beside ours and the smoother's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pinn_cli.paper.parameter_comparison import to_digits_of
from pinn_cli.paper.plan import source_title
from pinn_cli.paper.sheet import Cell, Mark, Row, Sheet, number

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pinn_cli.paper.case_runs import CaseRun, Variant
    from pinn_cli.paper.single_tables import CaseTable

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
TABLE1_NOTE = (
    "Of the 6-DOF chain whose estimator is given wrong values: k in N/m, c in N s/m, κ in N/m³. The true values are "
    "drawn as the authors' code draws them. Below them is what uncertain parameters and the smoother make of the "
    "prescribed values while they estimate the motion, which the paper does not attempt; "
    "there a mark says which of the two is nearer to the truth."
)


def parameter_sheet(
    table: CaseTable, published: pd.DataFrame, comparison: pd.DataFrame, sources: Sequence[Variant]
) -> Sheet:
    """The paper's layout: parameters downwards, cases side by side, a row per source.

    Args:
        table: Its name and title.
        published: The table's rows of ``published/parameters.csv``.
        comparison: From `pinn_cli.paper.parameter_comparison.compare_parameters`.
        sources: Variants, in the order of their rows; those without a run have none.
    """
    parameters = {case: list(cells["parameter"]) for case, cells in published.groupby("case", sort=False)}
    found = {(row["case"], row["variant"], row["parameter"]): row for row in comparison.to_dict(orient="records")}
    given = {(row["case"], row["parameter"]): row for row in published.to_dict(orient="records")}
    rows: list[Row] = []
    for place in range(max(map(len, parameters.values()))):
        names = {case: listed[place] for case, listed in parameters.items() if place < len(listed)}
        keys = [(case, names.get(case, "")) for case in parameters]
        cells = [cell for key in keys for cell in _published(given.get(key))]
        rows.append(Row(("/".join(dict.fromkeys(names.values())), "published"), tuple(cells), begins=True))
        for source in sources:
            ours = [found.get((case, source.name, name)) for case, name in keys]
            if any(ours):
                rows.append(Row(("", source_title(source)), tuple(cell for row in ours for cell in _ours(row))))
    groups = tuple((_CASES.get(str(case), str(case)), len(COLUMNS)) for case in parameters)
    columns = COLUMNS * len(groups)
    return Sheet(table.name, table.title, NOTE, ("Parameter", "Estimate"), groups, columns, tuple(rows))


def _published(row: Mapping[Any, Any] | None) -> list[Cell]:
    if row is None:
        return [Cell("")] * len(COLUMNS)
    return [number(row[name], "g") for name in ("true", "estimate", "error_percent", "std")]


def _ours(row: Mapping[Any, Any] | None) -> list[Cell]:
    if row is None:
        return [Cell("")] * len(COLUMNS)
    better = round(row["error_percent"], 2) < round(row["published_error_percent"], 2)
    mark: Mark = "worse" if row["larger_error"] else "better" if better else ""
    estimate = Cell(to_digits_of(row["std"], row["estimate"])) if np.isfinite(row["estimate"]) else Cell("-")
    return [Cell(""), estimate, number(row["error_percent"], ".2f", mark), number(row["std"], ".2g")]


def perturbed_comparison(drawn: pd.DataFrame, runs: Sequence[CaseRun]) -> pd.DataFrame:
    """Table 1 with a column of estimates per run.

    Args:
        drawn: From `pinn_cli.paper.single_tables.perturbed_parameters_comparison`.
        runs: Of ``sr_6dof_perturbed``.
    """
    table = drawn.copy()
    for run in runs:
        estimates = run.parameters.set_index("parameter")["estimate"]
        table[run.variant] = table["parameter"].map(estimates)
    return table


def perturbed_sheet(comparison: pd.DataFrame, sources: Sequence[Variant]) -> Sheet:
    """Table 1: a block of rows per kind of parameter, connections side by side.

    Args:
        comparison: From `perturbed_comparison`.
        sources: Variants whose estimates it has; others have no row.
    """
    kinds = comparison["parameter"].str.rpartition("_")[0]
    rows: list[Row] = []
    count = int(kinds.value_counts().max())
    known = [source for source in sources if source.name in comparison and comparison[source.name].notna().any()]
    for kind, block in comparison.groupby(kinds, sort=False):
        name = {"kappa": "κ", "mu": "μ"}.get(str(kind), str(kind))
        lines = [("prescribed", "prescribed"), ("true, published", "published"), ("true, drawn here", "drawn")]
        for position, (title, column) in enumerate(lines):
            cells = tuple(number(value, ".2f") for value in block[column])
            rows.append(Row((name if position == 0 else "", title), cells, begins=position == 0))
        errors = {source.name: (block[source.name] - block["drawn"]).abs() for source in known}
        rows += [
            Row(("", f"{source_title(source)}, estimate"), tuple(number(value, ".2f", _nearer(errors, source.name, i))
                for i, value in zip(block.index, block[source.name], strict=True)))
            for source in known
        ]  # fmt: skip
    return Sheet(
        "table1", "Table 1: prescribed, true and estimated parameters of the chain with wrong values", TABLE1_NOTE,
        ("Parameter", "Value"), (("Connection", count),), tuple(str(i) for i in range(1, count + 1)), tuple(rows),
    )  # fmt: skip


def _nearer(errors: Mapping[str, pd.Series[float]], name: str, position: Any) -> Mark:
    """Nothing is published to compare with: the better of the estimates is marked."""
    others = [round(error[position], 2) for other, error in errors.items() if other != name]
    return "better" if others and round(errors[name][position], 2) < min(others) else ""
