"""Both fitness formulas against hand-made values, and the table's groups and empty cells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pinn_cli.record.response import QUANTITIES
from pinn_cli.report.fitness import both_formulas, fitness_percent, fitness_table
from pinn_cli.report.results import LABELS, with_labels

SIGNALS = Path(__file__).resolve().parents[3] / "shared" / "data" / "reference_signals"


def test_values_worked_out_by_hand():
    truth = np.array([[0.0, 1.0], [2.0, 1.0], [4.0, 1.0]])
    estimate = np.array([[1.0, 1.0], [2.0, 1.0], [4.0, 1.0]])
    # error norm 1, norm of the deviation from the mean sqrt(8); RMSE sqrt(1/3), range 4; the second DOF is constant
    np.testing.assert_allclose(fitness_percent(estimate, truth), [100 * (1 - 1 / np.sqrt(8)), np.nan])
    np.testing.assert_allclose(by_range(estimate, truth), [100 * (1 - np.sqrt(1 / 3) / 4), np.nan])


def by_range(estimate, truth):
    return both_formulas(estimate, truth)[1]


@pytest.mark.parametrize("formula", [fitness_percent, by_range])
def test_a_perfect_estimate_scores_100(formula, make_case):
    truth = make_case().truth.response.displacement
    np.testing.assert_array_equal(formula(truth, truth), 100.0)


def test_the_mean_scores_0_by_the_printed_formula(make_case):
    truth = make_case().truth.response.velocity
    np.testing.assert_allclose(
        fitness_percent(np.broadcast_to(truth.mean(axis=0), truth.shape), truth), 0.0, atol=1e-10
    )


@pytest.mark.parametrize("formula", [fitness_percent, by_range])
def test_unknown_samples_are_left_out(formula, make_case):
    truth = make_case().truth.response.velocity
    estimate = truth + 0.1 * np.sin(np.arange(len(truth)))[:, None]
    gappy = truth.copy()
    gappy[::3, 0], gappy[:, 1] = np.nan, np.nan
    known = np.isfinite(gappy[:, 0])
    expected = formula(estimate[known, :1], truth[known, :1])[0]
    np.testing.assert_allclose(formula(estimate, gappy)[:3], [expected, np.nan, formula(estimate, truth)[2]])


def test_zero_prediction_on_the_papers_signals():
    if not SIGNALS.is_dir():
        pytest.skip(f"the reference signals are not at {SIGNALS}")
    signals = np.load(SIGNALS / "sr_6dof.npz")
    zero = np.zeros_like(signals["displacement"])
    assert abs(fitness_percent(zero, signals["displacement"]).mean()) < 1.0
    ranged = [by_range(zero, signals[quantity]).mean() for quantity in QUANTITIES[:3]]
    assert 76.0 < np.mean(ranged) < 84.0


def test_group_averages_go_over_the_filled_cells(make_case):
    case = make_case(ndof=4, observed=2)
    table = fitness_table(case.estimate.response, case.truth.response, case.record.observed)
    cells = table.set_index(["group", "quantity"])["fitness_percent"]
    by_dof = [cells[f"dof_{dof}", "velocity"] for dof in range(1, 5)]
    assert cells["all", "velocity"] == pytest.approx(np.mean(by_dof))
    assert cells["observed", "velocity"] == pytest.approx(np.mean(by_dof[:2]))
    assert cells["unobserved", "velocity"] == pytest.approx(np.mean(by_dof[2:]))
    assert cells["all", "force"] == cells["first", "force"] == cells["dof_1", "force"]
    assert all(np.isnan(cells[group, "force"]) for group in ("dof_2", "last", "unobserved"))


def test_a_quantity_that_is_not_estimated_is_empty(make_case):
    case = make_case()
    estimate = replace(case.estimate.response, force=np.full_like(case.record.force, np.nan))
    table = fitness_table(estimate, case.truth.response, case.record.observed)
    assert table.loc[table["quantity"] == "force", "fitness_percent"].isna().all()


def test_an_estimate_with_a_gap_is_refused(make_case):
    case = make_case()
    velocity = case.estimate.response.velocity.copy()
    velocity[5, 2] = np.inf
    estimate = replace(case.estimate.response, velocity=velocity)
    with pytest.raises(ValueError, match="velocity of DOF 3 is not finite"):
        fitness_table(estimate, case.truth.response, case.record.observed)


def test_labels_must_be_the_agreed_ones(make_case):
    case = make_case()
    table = with_labels(case.estimate.history, case.labels)
    assert list(table)[: len(LABELS)] == list(LABELS)
    with pytest.raises(ValueError, match="labels must be case, estimator"):
        with_labels(table, {"case": "small"})
