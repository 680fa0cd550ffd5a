"""Tables 2 and 5: fitness of the paper's cases, published beside ours and the smoother's."""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING, Any

from pinn_cli.paper.cases import SMOOTHER
from pinn_cli.paper.sheet import DASH, Cell, Row, Sheet, mark, number
from pinn_cli.record.response import QUANTITIES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas as pd

    from pinn_cli.paper.cases import CaseTable

    Columns = Mapping[str, Sequence[str]]  # group of DOFs to quantities

GROUP_TITLES = {
    "all": "All DOFs",
    "first": "First DOF",
    "last": "Last DOF",
    "observed": "Observed DOFs",
    "unobserved": "Unobserved DOFs",
}
_MODELS = {"none": "no error", "linear": "linear model", "perturbed": "wrong values"}
_CHAINS = {"duffing": "Duffing", "van_der_pol": "Van der Pol"}
NOTE = (
    "Fitness in percent by 100 (1 − RMSE / range), the formula behind the published values; rows called printed use "
    "100 (1 − ‖x − x̃‖ / ‖x − x̄‖), the formula that the paper prints. A dash: the true force is zero there."
)


def fitness_sheet(table: CaseTable, comparison: pd.DataFrame) -> Sheet:
    """The paper's layout: a block of rows per case, groups of DOFs side by side.

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
        for source in (*table.variants, SMOOTHER):
            ours = comparison[(comparison["case"] == case) & (comparison["variant"] == source.name)]
            if len(ours):
                found = by_cell(ours)
                rows.append(fitness_row("", source.source, _compared(found), columns))
                strict = {key: number(value, ".2f") for key, value in found["fitness_percent"].items()}
                printed.append(fitness_row("", f"{source.source}, printed", strict, columns))
        rows += printed
    return laid_out(table.name, table.title, NOTE, columns, rows)


def by_cell(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows by group of DOFs and quantity."""
    return rows.set_index(["group", "quantity"])


def _compared(found: pd.DataFrame) -> dict[Any, Cell]:
    ranged = found["range_fitness_percent"]
    marks = (mark(ours, given, more_is_better=True) for ours, given in zip(ranged, found["published"], strict=True))
    return {key: number(ours, ".2f", sign) for (key, ours), sign in zip(ranged.items(), marks, strict=True)}


def fitness_row(case: str, estimate: str, cells: Mapping[Any, Cell], columns: Columns) -> Row:
    """One row, dashes where there is no cell; that of a case begins a block, those called printed are secondary."""
    keys = [(group, quantity) for group, quantities in columns.items() for quantity in quantities]
    found = tuple(cells.get(key, Cell(DASH)) for key in keys)
    return Row((case, estimate), found, begins=bool(case), secondary=estimate.endswith(", printed"))


def laid_out(name: str, title: str, note: str, columns: Columns, rows: Sequence[Row]) -> Sheet:
    """Rows under groups of DOFs and quantities."""
    groups = tuple((GROUP_TITLES.get(group, group), len(quantities)) for group, quantities in columns.items())
    return Sheet(name, title, note, ("Case", "Estimate"), groups, tuple(chain(*columns.values())), tuple(rows))


def case_title(published: pd.DataFrame) -> str:
    """A case in a few words, from its published rows: 6 DOFs, Duffing, linear model, 50 dB."""
    case = published.iloc[0]
    system, model = _CHAINS[case["nonlinearity"]], _MODELS[case["model_error"]]
    return f"{case['ndof']} DOFs, {system}, {model}, {case['snr_db']:g} dB"
