"""Traces of a matrix times changes of sums over rows, against the sums themselves."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from pinn_cli.training.normal_matrix.elimination import Diagonals
from pinn_cli.training.normal_matrix.row_sums import RowSums
from pinn_cli.training.normal_matrix.separable_rows import LocalFeatures, SeparableRows
from pinn_cli.training.normal_matrix.traced_sums import Met, TracedSums

GROUPS, FEATURES, FUNCTIONS, ORDERS = 12, 4, 5, 3
COUNT = GROUPS - 1 + FEATURES


def windows(rng: np.random.Generator) -> list[LocalFeatures]:
    """Two windows of a record, whose features follow one another."""
    feature = torch.arange(GROUPS)[:, None] + torch.arange(FEATURES)
    values = torch.as_tensor(rng.normal(size=(GROUPS, 2, ORDERS, FEATURES)))
    return [LocalFeatures(feature[part], values[part]) for part in (slice(0, 5), slice(5, GROUPS))]


def rows(features: LocalFeatures, by_motion: np.ndarray, weight: np.ndarray) -> SeparableRows:
    """Without parameters."""
    groups, times = features.values.shape[:2]
    by = np.zeros((groups, times, FUNCTIONS, 1))
    return SeparableRows(features, by_motion, (by_motion != 0.0).any(0), weight, by, np.zeros((FUNCTIONS, 1), int), 0)


@pytest.mark.parametrize("reach", [1, 4], ids=["near functions", "all functions"])
@pytest.mark.parametrize("changing", [[], [2], [0, 1, 2, 3, 4]], ids=["no weight changes", "one does", "all do"])
def test_the_trace_is_that_of_the_sums(reach, changing):
    rng = np.random.default_rng(0)
    rank = rng.permutation(FUNCTIONS)
    coupling: Any = SimpleNamespace(size=FUNCTIONS, rank=rank, reach=reach)
    shape = 1, FEATURES, COUNT, coupling, 0
    offsets = np.arange(FEATURES * FUNCTIONS)
    values = rng.normal(size=(len(offsets), COUNT * FUNCTIONS))
    matrix, found = Diagonals(offsets, values), windows(rng)
    met = Met(matrix, coupling)
    behind = rank - rank[:, None]
    near = (behind >= 0) & (behind <= reach)
    for _ in range(2):  # the second time what meets the features is known
        sums, traced = [], []
        for _ in range(2):
            by_motion = rng.normal(size=(ORDERS, FUNCTIONS, FUNCTIONS)) * near
            sums.append(RowSums(*shape))
            traced.append(TracedSums(met, *shape))
            weights = np.random.default_rng(1)
            for features in found:
                weight = np.full((len(features.values), FUNCTIONS), 2.0)
                weight[:, changing] = weights.uniform(1.0, 3.0, (len(weight), len(changing)))
                for one in (sums[-1], traced[-1]):
                    one.add_separable(rows(features, by_motion, weight))
        above, below = (one.band for one in sums)
        expected = matrix.trace_of_product(above) - matrix.trace_of_product(below)
        assert met.trace(*traced) == pytest.approx(expected, rel=1e-10)
        assert np.abs(traced[0].band.values).max() == 0.0
