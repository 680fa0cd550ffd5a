"""The leading columns that say which run a row of a table belongs to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas

LABELS = ("case", "estimator", "scheme", "ndof", "nonlinearity", "model_error", "snr_db", "seed")


def with_labels(table: pandas.DataFrame, labels: Mapping[str, object]) -> pandas.DataFrame:
    """Return ``table`` with the columns of `LABELS` put before its own; a label that is None leaves its column empty.

    Raises:
        ValueError: If a label is missing or is none of `LABELS`: tables of different runs are concatenated, so all have
            the same columns.
    """
    if set(labels) != set(LABELS):
        raise ValueError(f"labels must be {', '.join(LABELS)}; given {', '.join(map(str, labels))}")
    labelled = table.copy()
    for position, name in enumerate(LABELS):
        labelled.insert(position, name, pd.Series([labels[name]] * len(table), index=table.index))
    return labelled
