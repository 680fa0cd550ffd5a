"""Published parameters beside ours: what the paper's tables of estimated parameters become."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pandas as pd

from pinn_cli.paper.comparison import markdown_row

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    from pinn_cli.paper.case_runs import CaseRun, Variant

COLUMNS = (
    "case", "variant", "parameter", "true", "published", "published_error_percent", "published_std", "estimate",
    "error_percent", "larger_error", "std", "lower_90", "upper_90", "truth_inside", "seconds", "process_seconds",
)  # fmt: skip
LARGER = "▲"
_PUBLISHED = {"estimate": "published", "error_percent": "published_error_percent", "std": "published_std"}
_OURS = ("true", "estimate", "error_percent", "std", "lower_90", "upper_90")


def compare_parameters(published: pd.DataFrame, runs: Sequence[CaseRun]) -> pd.DataFrame:
    """Every published parameter beside ours, one row per run.

    Args:
        published: Rows of `pinn_cli.report.published.parameters`.
        runs: Of the same cases; those of other cases add no rows.

    Returns:
        Columns `COLUMNS`, in the order of ``published``, run by run. ``true`` is the exact value that the record was
        simulated with, of which the paper prints two decimals. ``larger_error`` (than the published one) is decided at
        two decimals of a per cent; ``truth_inside`` says whether the 90 % interval holds the true value and is empty
        where there is no interval; ``published_std`` is empty where the paper gives none. A parameter that a run does
        not have leaves its cells empty.
    """
    parts = []
    for run in runs:
        cells = published.loc[published["case"] == run.case, ["parameter", "estimate", "error_percent", "std"]]
        cells = cells.rename(columns=_PUBLISHED)
        part = cells.merge(run.parameters[["parameter", *_OURS]], on="parameter", how="left", validate="one_to_one")
        part["larger_error"] = part["error_percent"].round(2) > part["published_error_percent"].round(2)
        inside = part["true"].between(part["lower_90"], part["upper_90"]).astype(object)
        part["truth_inside"] = inside.where(part[["true", "lower_90", "upper_90"]].notna().all(axis=1), None)
        parts.append(
            part.assign(case=run.case, variant=run.variant, seconds=run.seconds, process_seconds=run.process_seconds)
        )
    return pd.concat(parts, ignore_index=True)[list(COLUMNS)] if parts else pd.DataFrame(columns=list(COLUMNS))


def parameters_markdown(title: str, comparison: pd.DataFrame, variants: Sequence[Variant]) -> str:
    """One Markdown table per variant, a row per case and parameter: the published value, then ours."""
    lines = [
        f"# {title}",
        "",
        (
            "Errors are 100 |estimate − true| / |true|, in percent; std is the posterior standard deviation. "
            f"{LARGER} marks an error larger than the published one. Seconds are those of the whole process."
        ),
    ]
    for variant in variants:
        rows = comparison[comparison["variant"] == variant.name]
        if not rows.empty:
            lines += ["", f"## {variant.title[:1].upper()}{variant.title[1:]}", "", *_variant_table(rows)]
    return "\n".join(lines)


def _variant_table(rows: pd.DataFrame) -> list[str]:
    with_std = bool(rows["published_std"].notna().any())
    published = ("published", "error", "std") if with_std else ("published", "error")
    head = ("case", "parameter", "true", *published, "ours", "error", "std", "90 % interval", "holds the truth")
    lines = [markdown_row(*head), markdown_row("---", "---", *("---:" for _ in head[2:-1]), "---")]
    case = None
    for row in rows.to_dict(orient="records"):
        lines.append(markdown_row(str(row["case"]) if row["case"] != case else "", *_cells(row, with_std)))
        case = row["case"]
    judged = rows["truth_inside"].dropna()
    seconds = rows.groupby("case", sort=False)["process_seconds"].first()
    lines += [
        "",
        (
            f"{int(rows['larger_error'].sum())} of {len(rows)} errors are larger than the published ones; "
            f"{int(judged.sum())} of {len(judged)} intervals hold the truth. "
            f"Seconds: {', '.join(f'{name} {value:.1f}' for name, value in seconds.items())}."
        ),
    ]
    return lines


def _cells(row: Mapping[Hashable, Any], with_std: bool) -> list[str]:
    mark = f" {LARGER}" if row["larger_error"] else ""
    estimate, lower, upper = (to_digits_of(row["std"], row[name]) for name in ("estimate", "lower_90", "upper_90"))
    inside = "nan" if pd.isna(row["truth_inside"]) else "yes" if row["truth_inside"] else "no"
    return [
        str(row["parameter"]),
        f"{row['true']:.5g}",
        f"{row['published']:g}",
        f"{row['published_error_percent']:g}",
        *([f"{row['published_std']:g}"] if with_std else []),
        estimate,
        f"{row['error_percent']:.2f}{mark}",
        f"{row['std']:.2g}",
        "nan" if "nan" in (lower, upper) else f"{lower} to {upper}",
        inside,
    ]


def to_digits_of(std: float, value: float) -> str:
    """The value to the second digit of its standard deviation; to five digits where there is none."""
    if not std > 0.0:
        return f"{value:.5g}"
    return f"{value:.{max(1 - math.floor(math.log10(std)), 0)}f}"
