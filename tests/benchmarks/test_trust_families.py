"""What families of the referee draw: the same case again, records that begin with their truth, exact motions."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from benchmarks.trust.case import plain
from benchmarks.trust.families import drawn
from benchmarks.trust.structures import Connection, Structure, damping_matrix, linear_motion, simulated, sinusoids

ROWS = np.array([[1.0, 0, 0], [-1, 1, 0], [0, -1, 1], [0.6, 0, -0.8]])
FRAME = Structure(
    ("a", "b", "c"),
    np.array([2.0, 3.0, 1.5]),
    tuple(Connection(f"s{i}", row, values={"c": 1.5, "k": 4e3}) for i, row in enumerate(ROWS)),
)


@pytest.mark.parametrize(("family", "seed"), [("chain", 0), ("topology", 0)])
def test_a_seed_draws_the_same_case_again(family: str, seed: int) -> None:
    case, again = drawn(family, seed), drawn(family, seed)
    assert plain(case.settings) == plain(again.settings)
    assert case.truth.parameters == again.truth.parameters
    for name, record in case.records.items():
        pd.testing.assert_frame_equal(record, again.records[name], check_exact=True)
        assert np.isfinite(record["t"]).all()
    samples, dofs = case.truth.displacement.shape
    assert samples == len(next(iter(case.records.values())))
    assert set(case.truth.sensed) < set(range(dofs + 1))


def test_linear_motion_is_that_of_small_steps() -> None:
    frequencies = FRAME.modes()[0]
    force = sinusoids(np.random.default_rng(1), 0.4 * frequencies[0], 1.2 * frequencies[-1], 2.0)
    times = np.arange(0.0, 12.0 / frequencies[0], 0.3 / frequencies[-1])
    place = np.array([0.0, 1.0, -0.5])
    exact = linear_motion(FRAME, lambda t: force(t)[:, None] * place, times, 1.2 * frequencies[-1])
    small = simulated(FRAME, lambda t: force(t) * place, times, 1.2 * frequencies[-1])
    for quantity in ("displacement", "velocity", "acceleration"):
        found, expected = getattr(exact, quantity), getattr(small, quantity)
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_each_mode_has_its_damping_ratio() -> None:
    ratios = np.array([0.01, 0.03, 0.02])
    C = damping_matrix(FRAME, ratios)
    frequencies, shapes = FRAME.modes()
    np.testing.assert_allclose(shapes.T @ C @ shapes, np.diag(4.0 * np.pi * ratios * frequencies), atol=1e-9)
