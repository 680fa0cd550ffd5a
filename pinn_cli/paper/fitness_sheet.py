"""Tables 2 and 5: fitness of the paper's cases, published beside ours and the smoother's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pinn_cli.paper.comparison import GROUP_TITLES
from pinn_cli.paper.plan import source_title
from pinn_cli.paper.sheet import Cell, Mark, Row, Sheet, number
from pinn_cli.record.record import QUANTITIES

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd

    from pinn_cli.paper.case_runs import Variant
    from pinn_cli.paper.single_tables import CaseTable

_MODELS = {"none": "no error", "linear": "linear model", "perturbed": "wrong values"}
_CHAINS = {"duffing": "Duffing", "van_der_pol": "Van der Pol"}
NOTE = (
    "Fitness in percent by 100 (1 − RMSE / range), the formula behind the published values; rows called printed use "
    "100 (1 − ‖x − x̃‖ / ‖x − x̄‖), the formula that the paper prints. A dash: the true force is zero there."
)


def fitness_sheet(
    table: CaseTable, published: pd.DataFrame, comparison: pd.DataFrame, sources: Sequence[Variant]
) -> Sheet:
    """The paper's layout: a block of rows per case, groups of DOFs side by side.

    Args:
        table: Its name and title.
        published: The table's rows of ``published/fitness.csv``.
        comparison: From `pinn_cli.paper.comparison.compare_fitness`.
        sources: Variants, in the order of their rows; those without a run have none.
    """
    groups = list(dict.fromkeys(published["group"]))
    columns = [(group, quantity) for group in groups for quantity in QUANTITIES]
    rows: list[Row] = []
    for case, cells in published.groupby("case", sort=False):
        values = cells.set_index(["group", "quantity"])["fitness_percent"]
        heads = [(case_title(cells.iloc[0].to_dict()), "published")]
        rows.append(Row(heads[0], tuple(number(values.get(key, np.nan), ".2f") for key in columns), begins=True))
        ours = comparison[comparison["case"] == case]
        rows += _source_rows(ours, sources, columns)
    spans = tuple((GROUP_TITLES.get(group, group), len(QUANTITIES)) for group in groups)
    return Sheet(
        table.name,
        table.title,
        NOTE,
        ("Case", "Estimate"),
        spans,
        tuple(quantity for _, quantity in columns),
        tuple(rows),
    )


def case_title(case: dict[Any, Any]) -> str:
    """A case in a few words: 6 DOFs, Duffing, linear model, 50 dB."""
    chain, model = _CHAINS[case["nonlinearity"]], _MODELS[case["model_error"]]
    return f"{case['ndof']} DOFs, {chain}, {model}, {case['snr_db']:g} dB"


def _source_rows(ours: pd.DataFrame, sources: Sequence[Variant], columns: list[tuple[str, str]]) -> list[Row]:
    ranged, printed = [], []
    for source in sources:
        cells = ours[ours["variant"] == source.name].set_index(["group", "quantity"]).to_dict(orient="index")
        if not cells:
            continue
        ranged.append(Row(("", source_title(source)), tuple(_compared(cells.get(key)) for key in columns)))
        strict = tuple(number(cells[key]["fitness_percent"], ".2f") if key in cells else Cell("-") for key in columns)
        printed.append(Row(("", f"{source_title(source)}, printed"), strict, secondary=True))
    return ranged + printed


def _compared(cell: dict[Any, Any] | None) -> Cell:
    if cell is None:
        return Cell("-")
    value = round(cell["range_fitness_percent"], 2)
    mark: Mark = "worse" if cell["below_published"] else "better" if value > round(cell["published"], 2) else ""
    return number(cell["range_fitness_percent"], ".2f", mark)
