"""Published values beside ours: one row per cell or parameter and run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.paper.runs import CaseScores

FITNESS_COLUMNS = (
    "case", "variant", "group", "quantity", "published", "range_fitness_percent", "difference", "below_published",
    "fitness_percent", "seconds", "process_seconds",
)  # fmt: skip
PARAMETER_COLUMNS = (
    "case", "variant", "parameter", "true", "published", "published_error_percent", "published_std", "estimate",
    "error_percent", "larger_error", "std", "lower_90", "upper_90", "truth_inside", "seconds", "process_seconds",
)  # fmt: skip


def compare_fitness(published: pd.DataFrame, scores: Sequence[CaseScores]) -> pd.DataFrame:
    """Every published cell beside ours, one row per run.

    Args:
        published: Rows of `pinn_cli.report.published.fitness`.
        scores: Of the same cases; those of other cases add no rows.

    Returns:
        Columns `FITNESS_COLUMNS`, in the order of ``published``, run by run. ``difference`` is ours less the published
        value, both by the formula of the paper's tables; ``below_published`` is decided at the two decimals that the
        paper prints.
    """
    keys = ["group", "quantity"]
    parts = []
    for ours in scores:
        cells = published.loc[published["case"] == ours.case, [*keys, "fitness_percent"]]
        cells = cells.rename(columns={"fitness_percent": "published"})
        found = ours.fitness[[*keys, "fitness_percent", "range_fitness_percent"]]
        part = cells.merge(found, on=keys, how="left", validate="one_to_one")
        part["difference"] = part["range_fitness_percent"] - part["published"]
        part["below_published"] = part["range_fitness_percent"].round(2) < part["published"].round(2)
        parts.append(part)
    return _stacked(parts, scores, FITNESS_COLUMNS)


def compare_parameters(published: pd.DataFrame, scores: Sequence[CaseScores]) -> pd.DataFrame:
    """Every published parameter beside ours, one row per run.

    Args:
        published: Rows of `pinn_cli.report.published.parameters`.
        scores: Of the same cases; those of other cases add no rows.

    Returns:
        Columns `PARAMETER_COLUMNS`, in the order of ``published``, run by run. ``true`` is the exact value that the
        record was simulated with, of which the paper prints two decimals. ``larger_error`` (than the published one) is
        decided at two decimals of a per cent; ``truth_inside`` says whether the 90 % interval holds the true value and
        is empty where there is no interval; ``published_std`` is empty where the paper gives none. A parameter that a
        run does not have leaves its cells empty.
    """
    names = {"estimate": "published", "error_percent": "published_error_percent", "std": "published_std"}
    parts = []
    for ours in scores:
        cells = published.loc[published["case"] == ours.case, ["parameter", *names]].rename(columns=names)
        found = ours.parameters[["parameter", "true", "estimate", "error_percent", "std", "lower_90", "upper_90"]]
        part = cells.merge(found, on="parameter", how="left", validate="one_to_one")
        part["larger_error"] = part["error_percent"].round(2) > part["published_error_percent"].round(2)
        inside = part["true"].between(part["lower_90"], part["upper_90"]).astype(object)
        part["truth_inside"] = inside.where(part[["true", "lower_90", "upper_90"]].notna().all(axis=1), None)
        parts.append(part)
    return _stacked(parts, scores, PARAMETER_COLUMNS)


def _stacked(parts: list[pd.DataFrame], scores: Sequence[CaseScores], columns: tuple[str, ...]) -> pd.DataFrame:
    """One below the other, each with the labels of its run."""
    if not parts:
        return pd.DataFrame(columns=list(columns))
    labelled = [
        part.assign(case=ours.case, variant=ours.variant, seconds=ours.seconds, process_seconds=ours.process_seconds)
        for part, ours in zip(parts, scores, strict=True)
    ]
    return pd.concat(labelled, ignore_index=True)[list(columns)]


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
