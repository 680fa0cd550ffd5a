"""A sampled posterior as the estimates that every other scheme reports, and its diagnostics."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.report.results import with_labels
from pinn_cli.training.central_interval import CENTRAL_90
from pinn_cli.training.estimate import ParameterEstimate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pinn_cli.posterior.base import PosteriorSamples
    from pinn_cli.system.parameters import Parameter

DIAGNOSTICS = ("parameter", "mean", "std", "lower_90", "upper_90", "r_hat", "ess_bulk", "ess_tail", "mcse_mean")


def parameter_estimates(samples: PosteriorSamples, parameters: Sequence[Parameter]) -> list[ParameterEstimate]:
    """The posterior mean, standard deviation and central 90 % interval of every parameter, all of them unknown.

    Args:
        samples: p parameters, all chains together.
        parameters: Those p.
    """
    draws = samples.pooled
    lower, upper = np.quantile(draws, CENTRAL_90, axis=0)
    mean, std, prior_std = draws.mean(axis=0), draws.std(axis=0, ddof=1), samples.prior.std(axis=0, ddof=1)
    return [
        ParameterEstimate(
            replace(parameter, prior_std=float(prior_std[i]), unknown=True),
            float(mean[i]),
            float(std[i]),
            float(lower[i]),
            float(upper[i]),
        )
        for i, parameter in enumerate(parameters)
    ]


def posterior_correlation(draws: np.ndarray) -> np.ndarray:
    """(p, p) of draws (draws, p); NaN beside a parameter that does not move, 1 on the diagonal."""
    centred = draws - draws.mean(axis=0)
    length = np.linalg.norm(centred, axis=0)
    moving = np.where(length > 0.0, length, np.nan)
    correlation: np.ndarray = centred.T @ centred / np.outer(moving, moving)
    np.fill_diagonal(correlation, 1.0)
    return correlation


def diagnostics_table(diagnostics: pd.DataFrame, labels: Mapping[str, object]) -> pd.DataFrame:
    """The content of ``diagnostics.csv``.

    Args:
        diagnostics: With the columns `DIAGNOSTICS` at least.
        labels: A value for each of `pinn_cli.report.results.LABELS`.

    Returns:
        Columns: the labels and `DIAGNOSTICS`.
    """
    return with_labels(diagnostics[list(DIAGNOSTICS)], labels)


def worst_sampled(diagnostics: pd.DataFrame, most: int) -> list[str]:
    """The ``most`` parameters with the fewest effective draws, in their own order."""
    effective = diagnostics[["ess_bulk", "ess_tail"]].min(axis=1)
    kept = effective.sort_values(kind="stable").index[:most].sort_values()
    return [str(name) for name in diagnostics.loc[kept, "parameter"]]
