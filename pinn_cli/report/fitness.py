"""How well an estimated response agrees with the true one, by the paper's printed formula and by that of its tables.

The paper (section 'Case Studies', equation 'Fitness') prints 100 (1 - |x - x~| / |x - mean x|). Its tables were
computed by the authors' public code as 100 (1 - RMSE / (max x - min x)). A prediction of zero everywhere scores 0 by
the first and about 79 by the second on the paper's signals, so both are always reported, and neither is called by the
other's name.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from pinn_cli.record.response import QUANTITIES, Response

FORMULAS = ("fitness_percent", "range_fitness_percent")


def fitness_percent(estimate: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """100 (1 - |x - x~| / |x - mean x|) of every DOF, (dof,), the formula printed in the paper; see `both_formulas`."""
    return both_formulas(estimate, truth)[0]


def both_formulas(estimate: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """The paper's printed formula, and 100 (1 - RMSE / (max x - min x)), that behind its tables, of every DOF.

    Use the second only to compare with published numbers: it flatters, since the root mean square of a random signal is
    a small part of its range.

    Args:
        estimate: x~, (time, dof).
        truth: x, (time, dof); samples that are NaN are unknown and are left out of every sum.

    Returns:
        Percent, (2, dof). 100 is perfect; by the first, 0 is no better than the mean, below 0 is worse. NaN where the
        truth is constant or unknown, or where the estimate is NaN at a known sample.
    """
    if estimate.shape != truth.shape or truth.ndim != 2:
        raise ValueError(f"estimate {estimate.shape} and truth {truth.shape} must both be (time, dof)")
    known = np.isfinite(truth)
    residual = np.where(known, estimate - truth, 0.0)
    samples = np.maximum(known.sum(axis=0), 1)
    mean = np.where(known, truth, 0.0).sum(axis=0) / samples
    deviation = np.where(known, truth - mean, 0.0)
    rmse = np.sqrt((residual**2).sum(axis=0) / samples)
    span = np.max(truth, axis=0, initial=-np.inf, where=known) - np.min(truth, axis=0, initial=np.inf, where=known)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.linalg.norm(residual, axis=0) / np.linalg.norm(deviation, axis=0)
        return np.where(span > 0.0, 100.0 * (1.0 - np.stack([ratio, rmse / span])), np.nan)


def fitness_table(estimate: Response, truth: Response, observed: np.ndarray) -> pd.DataFrame:
    """Both fitness formulas for every group of DOFs and every quantity, one row each (the content of ``fitness.csv``).

    The groups are ``all``, ``first``, ``last``, ``observed``, ``unobserved`` and ``dof_1`` to ``dof_n``. Both formulas
    are evaluated DOF by DOF and then averaged over those DOFs of the group whose cell is not empty. A cell is empty
    (NaN) where the truth is constant (the force of an unforced DOF) or unknown, where the estimator gives no such
    quantity (its column is all NaN), and in a group without DOFs.

    Args:
        estimate: (time, dof) for each quantity.
        truth: The same, NaN where unknown.
        observed: (dof,) bool: DOFs with any response sensor.

    Raises:
        ValueError: If shapes disagree, or an estimated column is finite in one place and not in another: an average
            over what is left would hide it.
    """
    for quantity in QUANTITIES:
        estimated = np.isfinite(getattr(estimate, quantity))
        partly = np.flatnonzero(estimated.any(axis=0) & ~estimated.all(axis=0))
        if partly.size:
            raise ValueError(f"the estimated {quantity} of DOF {partly[0] + 1} is not finite at every time")
    scores = {name: both_formulas(getattr(estimate, name), getattr(truth, name)) for name in QUANTITIES}
    return fitness_rows(scores, observed)


def fitness_rows(scores: Mapping[str, np.ndarray], observed: np.ndarray) -> pd.DataFrame:
    """The same from both formulas of every DOF, (2, dof), for every quantity."""
    rows = []
    for group, members in groups(observed).items():
        for quantity in QUANTITIES:
            own = scores[quantity][:, members]
            filled = np.isfinite(own)
            counts, sums = filled.sum(axis=1), np.where(filled, own, 0.0).sum(axis=1)
            rows.append((group, quantity, *np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)))
    return pd.DataFrame(rows, columns=["group", "quantity", *FORMULAS])


def groups(observed: np.ndarray) -> dict[str, np.ndarray]:
    """The groups of DOFs that a table reports, in its order, each as a mask (dof,)."""
    dofs, seen = np.arange(1, len(observed) + 1), np.asarray(observed, dtype=bool)
    named = {"all": dofs > 0, "first": dofs == 1, "last": dofs == len(dofs), "observed": seen, "unobserved": ~seen}
    return named | {f"dof_{dof}": dofs == dof for dof in dofs}
