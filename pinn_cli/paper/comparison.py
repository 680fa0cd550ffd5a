"""Published values beside ours: long tables for files, short ones for readers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pinn_cli.record.record import QUANTITIES

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    from pinn_cli.paper.case_runs import CaseRun, Variant

COLUMNS = (
    "case", "variant", "group", "quantity", "published", "range_fitness_percent", "difference", "below_published",
    "fitness_percent", "seconds", "process_seconds",
)  # fmt: skip
SYMBOLS = {"displacement": "u", "velocity": "u̇", "acceleration": "ü", "force": "f"}
GROUP_TITLES = {
    "all": "All DOFs",
    "first": "First DOF",
    "last": "Last DOF",
    "observed": "Observed DOFs",
    "unobserved": "Unobserved DOFs",
}
BELOW = "▼"


def compare_fitness(published: pd.DataFrame, runs: Sequence[CaseRun]) -> pd.DataFrame:
    """Every published cell beside ours, one row per run.

    Args:
        published: Rows of `pinn_cli.report.published.fitness`.
        runs: Of the same cases; those of other cases add no rows.

    Returns:
        Columns `COLUMNS`, in the order of ``published``, run by run. ``difference`` is ours less the published value,
        both by the formula of the paper's tables; ``below_published`` is decided at the two decimals that the paper
        prints.
    """
    keys = ["group", "quantity"]
    parts = []
    for run in runs:
        cells = published.loc[published["case"] == run.case, [*keys, "fitness_percent"]]
        cells = cells.rename(columns={"fitness_percent": "published"})
        ours = run.fitness[[*keys, "fitness_percent", "range_fitness_percent"]]
        part = cells.merge(ours, on=keys, how="left", validate="one_to_one")
        part["difference"] = part["range_fitness_percent"] - part["published"]
        part["below_published"] = part["range_fitness_percent"].round(2) < part["published"].round(2)
        parts.append(
            part.assign(case=run.case, variant=run.variant, seconds=run.seconds, process_seconds=run.process_seconds)
        )
    return pd.concat(parts, ignore_index=True)[list(COLUMNS)] if parts else pd.DataFrame(columns=list(COLUMNS))


def fitness_markdown(title: str, comparison: pd.DataFrame, variants: Sequence[Variant]) -> str:
    """One Markdown table per group of DOFs: the published row, then two rows per variant, one of each formula."""
    below = int(comparison["below_published"].sum())
    lines = [
        f"# {title}",
        "",
        (
            "Fitness in percent. *Range* is 100 (1 − RMSE / range), the formula of the published values; *printed* is "
            "100 (1 − ‖x − x̃‖ / ‖x − x̄‖), the formula printed in the paper. In brackets: range less published. "
            f"{BELOW} marks a cell below the published one: {below} of {len(comparison)}. "
            "Seconds are those of the whole process."
        ),
    ]
    for group in dict.fromkeys(comparison["group"]):
        lines += ["", f"## {GROUP_TITLES.get(group, group)}", ""]
        lines += _group_table(comparison[comparison["group"] == group], variants)
    return "\n".join(lines)


def _group_table(rows: pd.DataFrame, variants: Sequence[Variant]) -> list[str]:
    quantities = [quantity for quantity in QUANTITIES if quantity in set(rows["quantity"])]
    lines = [
        markdown_row("case", "row", *(SYMBOLS[quantity] for quantity in quantities), "seconds"),
        markdown_row("---", "---", *("---:" for _ in quantities), "---:"),
    ]
    for case in dict.fromkeys(rows["case"]):
        cells = rows[rows["case"] == case].drop_duplicates("quantity").set_index("quantity")
        published = (f"{cells['published'].get(quantity, np.nan):.2f}" for quantity in quantities)
        lines.append(markdown_row(case, "published", *published, ""))
        for variant in variants:
            ours = rows[(rows["case"] == case) & (rows["variant"] == variant.name)].set_index("quantity")
            if not ours.empty:
                lines += _variant_rows(ours, variant, quantities)
    return lines


def _variant_rows(ours: pd.DataFrame, variant: Variant, quantities: Sequence[str]) -> list[str]:
    cells = ours.to_dict(orient="index")
    ranged = [_compared(cells[quantity]) if quantity in cells else "" for quantity in quantities]
    printed = [f"{ours['fitness_percent'].get(quantity, np.nan):.2f}" for quantity in quantities]
    return [
        markdown_row("", f"{variant.title}, range", *ranged, f"{ours['process_seconds'].iloc[0]:.1f}"),
        markdown_row("", f"{variant.title}, printed", *printed, ""),
    ]


def _compared(cell: Mapping[Hashable, Any]) -> str:
    mark = f" {BELOW}" if cell["below_published"] else ""
    return f"{cell['range_fitness_percent']:.2f} ({cell['difference']:+.2f}){mark}"


def markdown_row(*cells: str) -> str:
    """One row of a Markdown table; a number that is unknown shows as a dash."""
    return "| " + " | ".join("-" if cell.strip() == "nan" else cell for cell in cells) + " |"
