"""The table of system parameters."""

from __future__ import annotations

import numpy as np
import pytest
from small_estimates import parameter_estimate

from pinn_cli.report.parameters import PARAMETER_COLUMNS, parameter_table
from pinn_cli.report.results import LABELS


def test_error_is_relative_to_the_truth(make_case):
    labels = make_case().labels
    estimates = [
        parameter_estimate("k_2", 16.0, 14.7, 0.1, 14.5, 14.9),
        parameter_estimate("kappa_1", 90.0, 0.0, 1, 2, 3),
    ]
    table = parameter_table(estimates, {"k": np.array([1.0, 15.0]), "kappa": np.array([0.0, 7.0])}, labels)
    assert list(table) == [*LABELS, *PARAMETER_COLUMNS]
    assert table.loc[0, ["true", "prescribed", "estimate"]].tolist() == [15.0, 16.0, 14.7]
    assert table.loc[0, "error_percent"] == pytest.approx(2.0)
    assert np.isnan(table.loc[1, "error_percent"])


def test_an_unknown_parameter_has_a_start_and_nothing_prescribed(make_case):
    estimates = [
        parameter_estimate("k_1", 16.0, 14.7, 0.1, 14.5, 14.9),
        parameter_estimate("k_2", 5.0, 14.7, 0.1, 14.5, 14.9, unknown=True),
    ]
    table = parameter_table(estimates, None, make_case().labels)
    np.testing.assert_array_equal(table["prescribed"], [16.0, np.nan])
    np.testing.assert_array_equal(table["start"], [np.nan, 5.0])


@pytest.mark.parametrize("true", [None, {"m": np.ones(6)}])
def test_unknown_truth_is_empty(true, make_case):
    case = make_case()
    table = parameter_table(case.estimate.parameters, true, case.labels)
    assert table[["true", "error_percent"]].isna().all(axis=None)
    assert len(table) == 18


def test_no_parameters_leave_the_header(make_case):
    assert list(parameter_table([], None, make_case().labels)) == [*LABELS, *PARAMETER_COLUMNS]
