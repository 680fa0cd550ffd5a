"""How well parameters are determined: numbers, verdicts, and which of them a reader is warned of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_estimates import parameter_estimate

from pinn_cli.model.knowledge import ParameterKnowledge
from pinn_cli.report.parameters import (
    IDENTIFIABILITY_COLUMNS,
    WELL_DETERMINED,
    any_unknown,
    correlation_table,
    identifiability_table,
    identifiability_warnings,
)
from pinn_cli.report.results import LABELS
from pinn_cli.report.terminal.columns import MARK, WIDTH
from pinn_cli.training.estimate import Changes, ParameterEstimate

NAN = float("nan")


def parameter(
    name: str, estimate: float = 15.0, std: float = 0.15, prior_std: float = 10.0, unknown: bool = True
) -> ParameterEstimate:
    lower, upper = estimate - 1.645 * std, estimate + 1.645 * std
    return parameter_estimate(name, 10.0, estimate, std, lower, upper, prior_std, unknown)


def correlated(value: float, count: int = 2) -> np.ndarray:
    """All of ``count`` parameters independent, but for the first two."""
    matrix = np.eye(count)
    matrix[0, 1] = matrix[1, 0] = value
    return matrix


def test_numbers(make_case):
    parameters = [parameter("k_2"), parameter("k_4", -10.0, 1.0, 0.0), parameter("c_1", 1.0, 0.07, 0.075, False)]
    correlation = np.array([[1.0, 0.3, -0.4], [0.3, 1.0, 0.1], [-0.4, 0.1, 1.0]])
    table = identifiability_table(parameters, correlation, make_case().labels)
    assert list(table) == [*LABELS, *IDENTIFIABILITY_COLUMNS]
    np.testing.assert_allclose(table["std_ratio"], [0.015, NAN, 0.07 / 0.075])
    np.testing.assert_allclose(table["relative_std_percent"], [1.0, 10.0, 7.0])
    np.testing.assert_allclose(table["largest_correlation"], [-0.4, 0.3, -0.4])
    assert table["correlated_with"].tolist() == ["c_1", "k_2", "k_2"]
    assert table["verdict"].tolist()[:2] == [WELL_DETERMINED, WELL_DETERMINED]
    assert table["verdict"][2].startswith("c_1 rests on its prescribed value: its standard deviation is 93 %")


@pytest.mark.parametrize("correlation", [None, np.eye(1)])
def test_one_parameter_or_no_correlation_has_no_neighbour(correlation, make_case):
    table = identifiability_table([parameter("k_1")], correlation, make_case().labels)
    assert table[["largest_correlation", "correlated_with"]].isna().all(axis=None)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (parameter("kappa_2", 100.0, 48.0, 500.0), "kappa_2 is poorly determined: its standard deviation is 48 % of"),
        (parameter("kappa_2", 100.0, 62.0, 500.0), "kappa_2 cannot be told from zero: its standard deviation is 62 %"),
        (parameter("k_2", -10.0, 9.0, 500.0), "k_2 cannot be told from zero: its standard deviation is 90 % of"),
        (
            replace(parameter("k_2", 0.8, 0.6), held=True, upper_90=2.0),
            "k_2 is held at its lower bound of 0: all that is known is that it is below 2 (95 %)",
        ),
        (replace(parameter("kappa_2", 15.0, 1.0), held=True), "kappa_2 is held at its lower bound of 0"),
        (parameter("k_2", 15.0, 8.3), "the record says nearly nothing about k_2: its standard deviation is still 83 %"),
        (parameter("k_2", 60.0, 6.0), "k_2 leans on its prior: the record narrows its standard deviation only to 60 %"),
    ],
)
def test_the_gravest_thing_is_told_of_each(given, told):
    (line,) = identifiability_warnings([given], None)
    assert line.startswith(told)


def test_an_update_is_judged_by_what_was_believed_before_the_first_record(make_case):
    last = [parameter("k_2", 60.0, 6.0), parameter("k_3", 60.0, 8.0), parameter("c_1", 10.0, 0.9, 0.9, unknown=False)]
    assert len(identifiability_warnings(last, None)) == 2  # each leans on what the records before say
    nothing = np.zeros(3)
    known = ParameterKnowledge(nothing, np.eye(3), nothing, nothing, np.array([600.0, 10.0, 9.0]))
    changes = Changes((), (), 1.0, 1e-3, *[nothing] * 4)
    update = replace(make_case().estimate, parameters=last, known=known, changes=changes)
    judged = update.before_any_record
    (line,) = identifiability_warnings(judged, None)
    assert line.startswith("the record says nearly nothing about k_3: its standard deviation is still 80 %")
    table = identifiability_table(judged, None, make_case().labels)
    assert table["prior_std"].tolist() == [600.0, 10.0, 9.0]
    assert table["verdict"][0] == table["verdict"][2] == WELL_DETERMINED
    assert replace(update, changes=None).before_any_record is last


def test_prescribed_parameters_are_not_warned_of(make_case):
    parameters = [parameter("k_2"), parameter("c_1", 1.0, 0.9, 0.9, unknown=False)]
    assert identifiability_warnings(parameters, np.eye(2)) == []
    assert identifiability_table(parameters, np.eye(2), make_case().labels)["verdict"][1] != WELL_DETERMINED
    assert any_unknown(parameters)
    assert not any_unknown(parameters[1:])


def test_two_unknown_parameters_that_stand_in_for_each_other(make_case):
    parameters = [parameter("k_2", std=1.5), parameter("k_3", std=1.5), parameter("k_4")]
    correlation = correlated(-0.98, 3)
    told = "k_2 and k_3 can hardly be told apart (correlation -0.98): only a combination is known"
    assert identifiability_warnings(parameters, correlation) == [told]
    table = identifiability_table(parameters, correlation, make_case().labels)
    assert table["verdict"].tolist() == [told, told, WELL_DETERMINED]


def test_an_unknown_parameter_that_hangs_on_a_prescribed_one(make_case):
    parameters = [parameter("k_2", std=1.5), parameter("k_3", std=1.1, prior_std=4.0, unknown=False)]
    (line,) = identifiability_warnings(parameters, correlated(0.97))
    assert line.startswith("k_2 is known only as well as the prescribed k_3 (correlation 0.97)")
    verdicts = identifiability_table(parameters, correlated(0.97), make_case().labels)["verdict"].tolist()
    assert verdicts == [line, WELL_DETERMINED]


def test_correlated_parameters_that_are_known_anyway_are_well_determined():
    parameters = [parameter("k_2", std=0.01), parameter("kappa_2", 100.0, 20.0, 900.0)]
    assert identifiability_warnings(parameters, correlated(-0.99)) == []


def test_a_training_without_standard_deviations_is_told_once(make_case):
    parameters = [parameter_estimate(f"k_{i}", 10.0, 15.0, NAN, NAN, NAN, 10.0, True) for i in (2, 4)]
    (line,) = identifiability_warnings(parameters, None)
    assert line.startswith("this training gives no standard deviations")
    table = identifiability_table(parameters, None, make_case().labels)
    assert table["verdict"][0] == "k_2 has no standard deviation: this training gives none"


def test_lines_fit_the_terminal():
    parameters = [parameter(f"kappa_{i}", *values) for i, values in enumerate(((15.0, 8.3), (60.0, 6.0)), 10)]
    parameters += [replace(parameter("kappa_12", 0.8, 0.6), held=True)]
    parameters += [parameter("kappa_20", std=1.5), parameter("kappa_21", std=1.5)]
    correlation = np.eye(5)
    correlation[3, 4] = correlation[4, 3] = -0.98
    lines = identifiability_warnings(parameters, correlation)
    assert len(lines) == 4
    assert max(map(len, lines)) <= WIDTH - len(MARK)


def test_correlation_table():
    table = correlation_table([parameter("k_2"), parameter("k_4")], correlated(0.25))
    assert list(table) == ["parameter", "k_2", "k_4"]
    assert table["parameter"].tolist() == ["k_2", "k_4"]
    np.testing.assert_array_equal(table[["k_2", "k_4"]], [[1.0, 0.25], [0.25, 1.0]])
