"""The tables of parameters: estimates of a training and of draws, and how well they are determined."""

from dataclasses import replace

import numpy as np
import pytest
from fake_posteriors import CORRELATION, DUFFING, make_diagnostics, make_samples
from small_estimates import parameter_estimate

from pinn_cli.model.knowledge import ParameterKnowledge
from pinn_cli.report.parameters import (
    WELL_DETERMINED,
    identifiability_table,
    identifiability_warnings,
    parameter_estimates,
    parameter_table,
    posterior_correlation,
    worst_sampled,
)
from pinn_cli.report.text import MARK, WIDTH, curves_text
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Spline
from pinn_cli.system.parameters import Parameter
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


def test_an_error_is_relative_to_the_truth_and_an_unknown_parameter_has_a_start_and_nothing_prescribed():
    estimates = [parameter("k_2", 14.7), parameter("kappa_1", 0.0), parameter("c_1", unknown=False)]
    table = parameter_table(estimates, {"k": np.array([1.0, 15.0]), "kappa": np.array([0.0, 7.0])})
    np.testing.assert_allclose(table["true"], [15.0, 0.0, NAN])
    np.testing.assert_allclose(table["error_percent"], [2.0, NAN, NAN])
    np.testing.assert_array_equal(table["prescribed"], [NAN, NAN, 10.0])
    np.testing.assert_array_equal(table["start"], [10.0, 10.0, NAN])


def test_numbers():
    parameters = [parameter("k_2"), parameter("k_4", -10.0, 1.0, 0.0), parameter("c_1", 1.0, 0.07, 0.075, False)]
    correlation = np.array([[1.0, 0.3, -0.4], [0.3, 1.0, 0.1], [-0.4, 0.1, 1.0]])
    table = identifiability_table(parameters, correlation)
    np.testing.assert_allclose(table["std_ratio"], [0.015, NAN, 0.07 / 0.075])
    np.testing.assert_allclose(table["relative_std_percent"], [1.0, 10.0, 7.0])
    np.testing.assert_allclose(table["largest_correlation"], [-0.4, 0.3, -0.4])
    assert table["correlated_with"].tolist() == ["c_1", "k_2", "k_2"]
    assert table["verdict"].tolist()[:2] == [WELL_DETERMINED, WELL_DETERMINED]
    assert "rests on its prescribed value" in table["verdict"][2]
    assert identifiability_warnings(parameters, None) == []  # what was prescribed is not warned of
    for alone in (None, np.eye(1)):
        table = identifiability_table([parameter("k_1")], alone)
        assert table[["largest_correlation", "correlated_with"]].isna().all(axis=None)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (parameter("kappa_2", 100.0, 48.0, 500.0), "poorly determined"),
        (parameter("kappa_2", 100.0, 62.0, 500.0), "cannot be told from zero"),
        (parameter("k_2", -10.0, 9.0, 500.0), "cannot be told from zero"),
        (replace(parameter("k_2", 0.8, 0.6), held=True, upper_90=2.0), "below 2 (95 %)"),
        (replace(parameter("kappa_2", 15.0, 1.0), held=True), "held at its lower bound"),
        (parameter("k_2", 15.0, 8.3), "nearly nothing"),
        (parameter("k_2", 60.0, 6.0), "leans on its prior"),
    ],
)
def test_the_gravest_thing_is_told_of_each(given, told):
    (line,) = identifiability_warnings([given], None)
    assert given.name in line
    assert told in line
    assert len(line) <= WIDTH - len(MARK)


def test_an_update_is_judged_by_what_was_believed_before_the_first_record(make_case):
    last = [parameter("k_2", 60.0, 6.0), parameter("k_3", 60.0, 8.0), parameter("c_1", 10.0, 0.9, 0.9, unknown=False)]
    assert len(identifiability_warnings(last, None)) == 2  # each leans on what the records before say
    nothing = np.zeros(3)
    known = ParameterKnowledge(nothing, np.eye(3), nothing, nothing, np.array([600.0, 10.0, 9.0]))
    changes = Changes((), (), 1.0, 1e-3, *[nothing] * 4)
    update = replace(make_case().estimate, parameters=last, known=known, changes=changes)
    table = identifiability_table(update.before_any_record, None)
    assert table["prior_std"].tolist() == [600.0, 10.0, 9.0]
    assert [verdict == WELL_DETERMINED for verdict in table["verdict"]] == [True, False, True]
    assert replace(update, changes=None).before_any_record is last


def test_parameters_that_stand_in_for_each_other():
    parameters = [parameter("k_2", std=1.5), parameter("k_3", std=1.5), parameter("k_4")]
    correlation = correlated(-0.98, 3)
    (told,) = identifiability_warnings(parameters, correlation)
    assert "k_2 and k_3" in told
    assert identifiability_table(parameters, correlation)["verdict"].tolist() == [told, told, WELL_DETERMINED]
    beside = [parameter("k_2", std=1.5), parameter("k_3", std=1.1, prior_std=4.0, unknown=False)]
    (told,) = identifiability_warnings(beside, correlated(0.97))
    assert "prescribed k_3" in told
    assert identifiability_table(beside, correlated(0.97))["verdict"].tolist() == [told, WELL_DETERMINED]
    # What is known anyway is well determined, whatever shares its error.
    well = [parameter("k_2", std=0.01), parameter("kappa_2", 100.0, 20.0, 900.0)]
    assert identifiability_warnings(well, correlated(-0.99)) == []


def test_a_training_without_standard_deviations_is_told_once():
    parameters = [parameter(f"k_{i}", std=NAN) for i in (2, 4)]
    assert len(identifiability_warnings(parameters, None)) == 1
    assert identifiability_table(parameters, None)["verdict"].str.contains("no standard deviation").all()


def test_estimates_of_known_draws():
    draws = np.arange(1.0, 102.0).reshape(1, 101, 1)
    samples = replace(make_samples(("k_1",)), draws=draws, prior=np.array([[0.0], [2.0], [4.0]]))
    (k,) = parameter_estimates(samples, [Parameter("k", 0, 7.0)])
    assert (k.name, k.prescribed, k.unknown) == ("k_1", 7.0, True)
    assert (k.estimate, k.lower_90, k.upper_90) == pytest.approx((51.0, 6.0, 96.0))
    assert k.std == pytest.approx(np.std(draws, ddof=1))
    assert k.prior_std == pytest.approx(2.0)


def test_correlation_of_draws():
    draws = make_samples().pooled
    correlation = posterior_correlation(draws)
    assert correlation[2, 4] == pytest.approx(CORRELATION, abs=0.03)
    np.testing.assert_allclose(correlation, np.corrcoef(draws, rowvar=False), atol=1e-12)
    still = draws.copy()
    still[:, 0] = 1.0
    correlation = posterior_correlation(still)
    assert np.isnan(correlation[0, 1:]).all()
    assert np.isfinite(correlation[1:, 1:]).all()


def test_the_worst_sampled_keep_their_order():
    diagnostics = make_diagnostics(make_samples()).assign(ess_tail=[900.0, 800.0, 10.0, 900.0, 20.0, 900.0])
    assert worst_sampled(diagnostics, 3) == ["c_1", "k_1", "kappa_1"]
    assert worst_sampled(diagnostics, 9) == list(DUFFING)


def test_nothing_is_said_of_one_term_of_a_curve():
    law = Spline(elongation=0.1, terms=4)
    chain = build_chain(1, law, m=1.0, c=1.0, k=1.0, **dict.fromkeys(law.parameters, 0.0))
    poor = [
        ParameterEstimate(replace(p, prior_std=10.0, unknown=True), 1.0, 5.0, -7.0, 9.0)
        for p in chain.every_parameter()
        if p.kind not in ("m", "c")
    ]
    assert [bool(p.parameter.curve) for p in poor] == [False, True, True, True, True]
    together = np.full((5, 5), 0.999) + 0.001 * np.eye(5)
    assert all("k_1" in warning for warning in identifiability_warnings(poor, together))
    assert "4 terms" in curves_text(4)
    assert curves_text(0) == ""
