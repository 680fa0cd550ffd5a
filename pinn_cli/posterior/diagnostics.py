"""Whether draws can be trusted: R-hat, effective sample sizes and divergences, and what they mean in plain words.

Limits as in Vehtari, Gelman, Simpson, Carpenter and Bürkner, Rank-normalization, folding, and localization: an improved
R-hat, Bayesian Analysis 16 (2021).
"""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pandas as pd

from pinn_cli.posterior.base import PosteriorSamples
from pinn_cli.training.central_interval import CENTRAL_90

R_HAT = 1.01
EFFECTIVE_DRAWS = 400


def diagnose(samples: PosteriorSamples) -> pd.DataFrame:
    """One row for each parameter, then one for each measured force's noise, ``sigma_force_1``.

    Columns: ``parameter``, ``mean``, ``std``, ``lower_90``, ``upper_90`` (quantiles), all in SI units; ``r_hat``,
    ``ess_bulk``, ``ess_tail`` (effective numbers of draws), NaN where the draws are independent anyway (``laplace``);
    ``mcse_mean``, what the finite number of draws leaves uncertain about the mean.
    """
    columns = {name: samples.draws[..., i] for i, name in enumerate(samples.names)}
    columns |= {f"sigma_force_{dof}": samples.sigma_force[..., i] for i, dof in enumerate(samples.force_dofs)}
    sampled = bool(samples.statistics)
    return pd.DataFrame([{"parameter": name, **_row(draws, sampled)} for name, draws in columns.items()])


def divergences(samples: PosteriorSamples) -> int:
    """How many of the draws came from a trajectory that left the density."""
    return int(np.sum(samples.statistics.get("diverging", 0)))


def verdict(table: pd.DataFrame, samples: PosteriorSamples) -> list[str]:
    """What is wrong with the draws, a line each, and what to do about it; nothing where all is well.

    Args:
        table: What :func:`diagnose` says of ``samples``.
        samples: The draws.
    """
    if not samples.statistics:
        return []
    lines = [line for row in table.to_dict("records") for line in _faults(row, samples.draws.shape[1])]
    diverged = divergences(samples)
    if diverged:
        total = samples.draws.shape[0] * samples.draws.shape[1]
        lines.append(
            f"{diverged} of {total} draws diverged: NUTS cannot follow the posterior everywhere, so intervals may be "
            "wrong; raise posterior.target_accept (0.95, 0.99), or give narrower priors"
        )
    return lines


def _faults(row: dict[Any, Any], draws: int) -> list[str]:
    name, r_hat = row["parameter"], row["r_hat"]
    if not math.isfinite(r_hat):
        return [f"{name} does not move: its draws are all the same or not finite; look at its prior"]
    lines = []
    if r_hat > R_HAT:
        lines.append(
            f"{name}: the chains disagree (R-hat {r_hat:.3f}, must be at most {R_HAT}); raise posterior.warmup and "
            f"posterior.draws (to {2 * draws}, say)"
        )
    kinds = (("ess_bulk", "its mean"), ("ess_tail", "its 90 % interval"))
    short = [(row[kind], what) for kind, what in kinds if row[kind] < EFFECTIVE_DRAWS]
    if short:
        effective, what = min(short)
        enough = math.ceil(1.2 * draws * EFFECTIVE_DRAWS / max(effective, 1.0) / 100) * 100
        lines.append(
            f"{name}: only {effective:.0f} effective draws for {what} (must be at least {EFFECTIVE_DRAWS}); raise "
            f"posterior.draws to {enough}"
        )
    return lines


def _row(draws: np.ndarray, sampled: bool) -> dict[str, float]:
    """Of one parameter (chains, draws)."""
    lower, upper = np.quantile(draws, CENTRAL_90)
    std = float(draws.std(ddof=1))
    row = {"mean": float(draws.mean()), "std": std, "lower_90": float(lower), "upper_90": float(upper)}
    if not sampled:
        unknown = dict.fromkeys(("r_hat", "ess_bulk", "ess_tail"), math.nan)
        return row | unknown | {"mcse_mean": std / math.sqrt(draws.size)}
    arviz = import_arviz()
    with np.errstate(all="ignore"):
        return row | {
            "r_hat": float(arviz.rhat(two_chains(draws))),
            "ess_bulk": float(arviz.ess(draws, method="bulk")),
            "ess_tail": float(arviz.ess(draws, method="tail")),
            "mcse_mean": float(arviz.mcse(draws, method="mean")),
        }


def two_chains(draws: np.ndarray) -> np.ndarray:
    """Draws (chains, draws), a single chain as its two halves: ArviZ has no R-hat for one."""
    if len(draws) > 1:
        return draws
    half = draws.shape[1] // 2
    return draws[0, : 2 * half].reshape(2, half)


def import_arviz() -> Any:
    """ArviZ, which takes two seconds to import and announces its next version while it does."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import arviz
    return arviz
