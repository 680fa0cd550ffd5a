"""Drifts of connections and of pairs of DOFs: how far each is stretched, and how far at most (``drift.csv``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.report.results import with_labels
from pinn_cli.training.central_interval import HALF_WIDTH_90

if TYPE_CHECKING:
    from collections.abc import Mapping

    from scipy.sparse import csr_matrix

    from pinn_cli.record.response import Response
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import Estimate

COLUMNS = (
    "connection", "peak", "std", "lower_90", "upper_90", "time_of_peak", "true_peak", "true_time_of_peak",
    "error_percent",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Drifts:
    """Elongations of C connections and pairs over time: of a storey, its drift.

    Attributes:
        time: (N,), s.
        names: Of the connections, their numbers from 1 where they have none; then those of the pairs.
        estimate: (N, C), m.
        std: (N, C), m; NaN where the estimator gives none.
        true: (N, C), m; NaN where unknown.
    """

    time: np.ndarray
    names: tuple[str, ...]
    estimate: np.ndarray
    std: np.ndarray
    true: np.ndarray

    @classmethod
    def of(cls, structure: Structure, estimate: Estimate, truth: Response) -> Drifts:
        """Of an estimate.

        Args:
            structure: Whose connections they are.
            estimate: Its displacements tell the drifts.
            truth: NaN where unknown: a connection is known where all that it joins are.
        """
        stretch, known = structure.drifts_of_dofs, estimate.connections
        found = _with_supports(estimate.response, structure.supports) @ stretch.T
        std = np.full(found.shape, np.nan) if known is None else known.elongation_std
        return cls(
            estimate.response.time,
            structure.drift_names,
            found,
            std,
            _elongation(stretch, _with_supports(truth, structure.supports)),
        )

    def peak(self, histories: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Largest absolute value of histories (N, C) and its sample, each (C,)."""
        sample = np.argmax(np.abs(histories), axis=0)
        return np.abs(histories[sample, np.arange(histories.shape[1])]), sample


def drift_table(drifts: Drifts, labels: Mapping[str, object]) -> pd.DataFrame:
    """One row per connection and pair (the content of ``drift.csv``).

    Args:
        drifts: Of the estimate.
        labels: A value for each of `pinn_cli.report.results.LABELS`.

    Returns:
        Columns: the labels and `COLUMNS`. ``peak`` is the largest absolute drift, m, at ``time_of_peak``, s. Its 90 %
        interval is that of the drift at this time: two peaks of nearly the same height are not told apart.
        ``error_percent`` is 100 |peak - true_peak| / true_peak. Cells of what is not known are empty (NaN).
    """
    peak, sample = drifts.peak(drifts.estimate)
    std = drifts.std[sample, np.arange(len(peak))]
    true, when = drifts.peak(drifts.true)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.where(true > 0.0, 100.0 * np.abs(peak - true) / true, np.nan)
    table = pd.DataFrame(
        {
            "connection": drifts.names,
            "peak": peak,
            "std": std,
            "lower_90": np.maximum(peak - HALF_WIDTH_90 * std, 0.0),
            "upper_90": peak + HALF_WIDTH_90 * std,
            "time_of_peak": drifts.time[sample],
            "true_peak": true,
            "true_time_of_peak": np.where(np.isfinite(true), drifts.time[when], np.nan),
            "error_percent": error,
        },
        columns=list(COLUMNS),
    )
    return with_labels(table, labels)


def _with_supports(response: Response, supports: int) -> np.ndarray:
    """(N, n + S), displacements of DOFs and of supports, NaN where these are not known."""
    if not supports:
        return response.displacement
    unknown = np.full((len(response.time), supports), np.nan)
    return np.hstack((response.displacement, unknown if response.supports is None else response.supports[:, 0]))


def _elongation(stretch: csr_matrix, displacement: np.ndarray) -> np.ndarray:
    """(N, C) of displacements (N, n + S) that may be NaN."""
    unknown = np.isnan(displacement).any(axis=0)
    joins = abs(stretch) @ unknown.astype(float) > 0.0
    known = np.nan_to_num(displacement) @ stretch.T
    return np.where(joins, np.nan, known)
