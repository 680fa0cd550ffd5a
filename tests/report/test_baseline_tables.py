"""A baseline's estimate next to the network's: rows, variables and text."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pinn_cli.report.dataset import response_dataset
from pinn_cli.report.figures import response_figure
from pinn_cli.report.results import RunDescription
from pinn_cli.report.tables import EstimatorTables
from pinn_cli.report.terminal.columns import WIDTH
from pinn_cli.report.terminal.fitness import comparison_text


def tables(case, name, estimate=None) -> EstimatorTables:
    labels = {label: value for label, value in case.labels.items() if label != "estimator"}
    run = RunDescription("small", 0, "cpu", 1, "", labels, True, "none", "kalman_smoother")
    return EstimatorTables.of(name, run, estimate or case.estimate, case.record, case.truth)


def test_its_rows_lie_below_those_of_the_network(make_case):
    case = make_case(ndof=3)
    ours = tables(case, "pinn")
    both = ours.above(tables(case, "kalman_smoother"))
    for name in ("fitness", "parameters", "residuals"):
        table, rows = getattr(both, name), len(getattr(ours, name))
        assert list(table.columns) == list(getattr(ours, name).columns)
        assert table["estimator"].tolist() == ["pinn"] * rows + ["kalman_smoother"] * rows
    assert ours.above(None) is ours


def test_no_parameters_in_either_leave_an_empty_table(make_case):
    case = make_case(ndof=3)
    none = tables(case, "pinn", replace(case.estimate, parameters=[]))
    assert list(none.above(none).parameters.columns) == list(none.parameters.columns)


def test_its_variables_carry_its_name(make_case):
    case = make_case(ndof=3)
    smoothed = ("kalman_smoother", case.estimate)
    dataset = response_dataset(case.estimate, case.record, case.truth.response, case.labels, baseline=smoothed)
    for quantity in ("displacement", "velocity", "acceleration", "force"):
        assert dataset[f"{quantity}_kalman_smoother"].attrs["units"] == dataset[quantity].attrs["units"]
        assert dataset[f"{quantity}_kalman_smoother_std"].shape == dataset[quantity].shape


@pytest.mark.parametrize("worse", [1.0, -1e6])
def test_the_text_compares_both(make_case, worse):
    case = make_case(ndof=6)
    response = replace(case.estimate.response, displacement=worse * case.estimate.response.displacement)
    theirs = tables(case, "kalman_smoother", replace(case.estimate, response=response)).fitness
    seconds = {"estimate": 1.26, "baseline": 12.0}
    text = comparison_text(tables(case, "pinn").fitness, "kalman_smoother", theirs, seconds)
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
