"""A baseline's estimate beside the network's: rows, variables and text."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pinn_cli.report.beside import Beside, stacked
from pinn_cli.report.dataset import response_dataset
from pinn_cli.report.figures import response_figure
from pinn_cli.report.fitness import fitness_table
from pinn_cli.report.parameters import parameter_table
from pinn_cli.report.residuals import residual_table
from pinn_cli.report.terminal import WIDTH


def beside(case, estimate=None) -> Beside:
    labels = case.labels | {"estimator": "kalman_smoother"}
    estimate = estimate or case.estimate
    fitness = fitness_table(estimate.response, case.truth.response, case.record.observed, labels)
    parameters = parameter_table(estimate.parameters, None, labels)
    return Beside("kalman_smoother", estimate, fitness, parameters, residual_table(estimate, case.record, None, labels))


def test_its_rows_lie_below_those_of_the_network(make_case):
    case = make_case(ndof=3)
    ours = fitness_table(case.estimate.response, case.truth.response, case.record.observed, case.labels)
    table = stacked(ours, beside(case).fitness)
    assert list(table.columns) == list(ours.columns)
    assert table["estimator"].tolist() == ["pinn"] * len(ours) + ["kalman_smoother"] * len(ours)


def test_no_parameters_in_either_leave_an_empty_table(make_case):
    case = make_case(ndof=3)
    none = parameter_table([], None, case.labels)
    assert list(stacked(none, none).columns) == list(none.columns)


def test_its_variables_carry_its_name(make_case):
    case = make_case(ndof=3)
    dataset = beside(case).variables(response_dataset(case.estimate, case.record, case.truth.response, case.labels))
    for quantity in ("displacement", "velocity", "acceleration", "force"):
        assert dataset[f"{quantity}_kalman_smoother"].attrs["units"] == dataset[quantity].attrs["units"]
        assert dataset[f"{quantity}_kalman_smoother_std"].shape == dataset[quantity].shape


@pytest.mark.parametrize("worse", [1.0, -1e6])
def test_the_text_compares_both(make_case, worse):
    case = make_case(ndof=6)
    response = replace(case.estimate.response, displacement=worse * case.estimate.response.displacement)
    ours = fitness_table(case.estimate.response, case.truth.response, case.record.observed, case.labels)
    text = beside(case, replace(case.estimate, response=response)).text(ours, {"estimate": 1.26, "baseline": 12.0})
    lines = text.splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert [line.split()[0] for line in lines[-2:]] == ["pinn", "kalman_smoother"]
    assert [line.split()[-1] for line in lines[-2:]] == ["1.3", "12.0"]


def test_its_line_is_in_the_legend(make_case):
    case = make_case(ndof=2, observed=1)
    figure = response_figure(
        case.estimate, case.record, case.truth.response, baseline=("kalman_smoother", case.truth.response)
    )
    assert "kalman smoother" in [text.get_text() for text in figure.legends[0].get_texts()]


def test_the_legend_of_everything_fits_the_page(make_case):
    case = make_case(ndof=2, observed=1, samples=4096)
    truth = case.truth.response
    figure = response_figure(case.estimate, case.record, truth, truth, baseline=("kalman_smoother", truth))
    figure.draw_without_rendering()
    extent = figure.legends[0].get_window_extent()
    assert len(figure.legends[0].get_texts()) == 6
    assert extent.x0 > 0
    assert extent.x1 < figure.bbox.x1
