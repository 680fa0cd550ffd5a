"""Tables 2 and 5: fitness of the paper's cases, published beside ours and the smoother's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pinn_cli.paper.cases import SMOOTHER
from pinn_cli.paper.sheet import DASH, Cell, Mark, Row, Sheet, number
from pinn_cli.record.record import QUANTITIES

if TYPE_CHECKING:
    import pandas as pd

    from pinn_cli.paper.cases import CaseTable, Variant

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
    published = table.values
    groups = tuple((group, QUANTITIES) for group in dict.fromkeys(published["group"]))
    columns = [(group, quantity) for group, quantities in groups for quantity in quantities]
    rows: list[Row] = []
    for case, cells in published.groupby("case", sort=False):
        values = cells.set_index(["group", "quantity"])["fitness_percent"]
        head = (case_title(cells.iloc[0].to_dict()), "published")
        rows.append(Row(head, tuple(number(values.get(key, np.nan), ".2f") for key in columns), begins=True))
        rows += _rows_of_ours(comparison[comparison["case"] == case], (*table.variants, SMOOTHER), columns)
    spans = tuple((GROUP_TITLES.get(group, group), len(quantities)) for group, quantities in groups)
    quantities = tuple(quantity for _, quantity in columns)
    return Sheet(table.name, table.title, NOTE, ("Case", "Estimate"), spans, quantities, tuple(rows))


def case_title(case: dict[Any, Any]) -> str:
    """A case in a few words: 6 DOFs, Duffing, linear model, 50 dB."""
    chain, model = _CHAINS[case["nonlinearity"]], _MODELS[case["model_error"]]
    return f"{case['ndof']} DOFs, {chain}, {model}, {case['snr_db']:g} dB"


def _rows_of_ours(ours: pd.DataFrame, sources: tuple[Variant, ...], columns: list[tuple[str, str]]) -> list[Row]:
    ranged, printed = [], []
    for source in sources:
        cells = ours[ours["variant"] == source.name].set_index(["group", "quantity"]).to_dict(orient="index")
        if not cells:
            continue
        ranged.append(Row(("", source.source), tuple(_compared(cells.get(key)) for key in columns)))
        strict = tuple(number(cells[key]["fitness_percent"], ".2f") if key in cells else Cell(DASH) for key in columns)
        printed.append(Row(("", f"{source.source}, printed"), strict, secondary=True))
    return ranged + printed


def _compared(cell: dict[Any, Any] | None) -> Cell:
    if cell is None:
        return Cell(DASH)
    value = round(cell["range_fitness_percent"], 2)
    mark: Mark = "worse" if cell["below_published"] else "better" if value > round(cell["published"], 2) else ""
    return number(cell["range_fitness_percent"], ".2f", mark)
