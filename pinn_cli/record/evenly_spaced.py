"""A few of many samples."""

from __future__ import annotations

import numpy as np


def evenly_spaced(available: int, count: int) -> np.ndarray:
    """(count,) indices of ``available`` samples, spread evenly, the first and the last included."""
    return np.linspace(0, available - 1, count).round().astype(np.int64)
