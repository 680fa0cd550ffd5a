"""The values that the paper published, as data: its tables of fitness, of estimated and of perturbed parameters."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources

import pandas as pd


def fitness() -> pd.DataFrame:
    """The fitness tables: ``table, case, ndof, nonlinearity, model_error, snr_db, group, quantity, fitness_percent``.

    The column is called as in the paper; the numbers are of the formula 100 (1 - RMSE / range), so compare them with
    ``range_fitness_percent`` (see `pinn_cli.report.fitness`).
    """
    return _load("fitness")


def fitness_of(labels: Mapping[str, object]) -> pd.DataFrame:
    """The rows of a run's case; none once a setting that makes it that case was changed."""
    values, same = fitness(), ["case", "ndof", "nonlinearity", "model_error", "snr_db"]
    return values[(values[same] == [labels[name] for name in same]).all(axis=1)]


def parameters() -> pd.DataFrame:
    """The tables of estimated parameters: ``table, case, parameter, true, estimate, error_percent, std`` (if given)."""
    return _load("parameters")


def perturbed_parameters() -> pd.DataFrame:
    """The parameters of the sparse-recovery case with wrong values: ``table, case, parameter, prescribed, true``."""
    return _load("perturbed_parameters")


def _load(name: str) -> pd.DataFrame:
    with (resources.files("pinn_cli.report") / "published" / f"{name}.csv").open(encoding="utf-8") as file:
        return pd.read_csv(file)
