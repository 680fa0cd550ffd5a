"""The benchmark's bar: the best level of the grid, for each quantity by itself."""

import pandas as pd
import pytest

from benchmarks.against_smoother import compared, errors
from pinn_cli.record.response import QUANTITIES


def test_ours_is_compared_with_the_best_level_of_each_quantity():
    means = {"uncertain": 1.1, "fixed": 1.0, "evidence": 1.2, "process noise 0.1 N": 1.0, "process noise 1 N": 2.0}
    rows = pd.DataFrame(
        {"estimator": name, "snr_db": 20, "seed": seed, **dict.fromkeys(QUANTITIES, value + 0.1 * (2 * seed - 1))}
        for name, value in means.items()
        for seed in (0, 1)
    )
    rows.loc[rows["estimator"] == "process noise 1 N", "force"] = 0.5
    table = compared(rows).set_index(["estimator", "quantity"])
    assert table.loc[("uncertain", "velocity"), "ratio"] == pytest.approx(1.1)
    assert table.loc[("uncertain", "velocity"), "hand_tuned_level"] == "0.1 N"
    assert table.loc[("fixed", "force"), "ratio"] == pytest.approx(2.0)
    assert table.loc[("fixed", "force"), "hand_tuned_level"] == "1 N"


def test_an_error_is_what_the_printed_formula_leaves(make_case):
    case = make_case(ndof=3, samples=60)
    found = errors(case.estimate, case.truth.response)
    assert set(found) == set(QUANTITIES)
    assert all(value >= 0.0 for value in found.values())
