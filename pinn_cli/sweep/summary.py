"""Mean and spread over the seeds of a sweep, for every setting that it sweeps."""

from __future__ import annotations

import re
from collections.abc import Sequence

import pandas as pd

from pinn_cli.report.fitness import FORMULAS
from pinn_cli.sweep.jobs import FAILED, FINISHED
from pinn_cli.sweep.tables import STATUS

SUMMARY = "summary.csv"
OVERALL = "all"
_OF_A_ROW = ("estimator", "group", "quantity")


def is_seed(setting: str) -> bool:
    """Whether a setting is the seed of something random, which is averaged over."""
    return re.fullmatch(r"(?:.*[._])?seeds?", setting) is not None


def compared_settings(fitness: pd.DataFrame, swept: Sequence[str]) -> list[str]:
    """Those of a sweep's settings that are no seeds, in the order typed."""
    return [setting for setting in swept if setting in fitness and not is_seed(setting)]


def summarise(fitness: pd.DataFrame, swept: Sequence[str]) -> pd.DataFrame:
    """The fitness by setting, over the seeds.

    Args:
        fitness: The sweep's `fitness.csv`; its swept settings as text.
        swept: Names of the settings that it sweeps, seeds among them.

    Returns:
        A row per swept setting's value, estimator, group of DOFs and quantity, in the order of the sweep: mean and
        standard deviation (over the draws, n - 1; empty for one) of both formulas, how many `seeds` they are over, and
        how many jobs with that setting `failed`. Where there is no truth there is no row.
    """
    settings = compared_settings(fitness, swept)
    by = [*settings, *_OF_A_ROW]
    finished = fitness[(fitness[STATUS] == FINISHED) & fitness["fitness_percent"].notna()]
    grouped = finished.groupby(by, sort=False, dropna=False)
    parts = {f"{formula}_{name}": getattr(grouped[formula], name)() for formula in FORMULAS for name in ("mean", "std")}
    table = pd.DataFrame({**parts, "seeds": grouped[FORMULAS[0]].count()}).reset_index()
    failures = fitness[fitness[STATUS] == FAILED]
    if not settings:
        return table.assign(failed=len(failures))
    failed = failures.groupby(settings, sort=False, dropna=False).size().rename("failed").reset_index()
    table = table.merge(failed, on=settings, how="left" if len(table) else "outer")
    return table.assign(failed=table["failed"].fillna(0).astype(int))
