"""What a run leaves of the motion of the ground, estimated or not: histories, residuals, figures, a free run."""

from dataclasses import replace

import numpy as np
import pytest
from small_estimates import results_of

from pinn_cli.record.excitation.ground_motion import GroundMotion
from pinn_cli.record.record import Truth
from pinn_cli.record.response import Response
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation
from pinn_cli.report.figures.histories import response_figure
from pinn_cli.report.figures.sensors import residuals_figure
from pinn_cli.report.fitness import residual_table
from pinn_cli.report.free_run import free_run
from pinn_cli.report.netcdf import response_dataset
from pinn_cli.report.text import sensors_text
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.training.noise_model import FoundNoise

NOISE = 0.05


@pytest.fixture
def shaken(make_case):
    """A small case whose ground moves, with its acceleration estimated and measured with noise."""
    case = make_case(ndof=3, observed=2)
    true = np.sin(3.0 * case.record.time)
    measured = true + NOISE * np.random.default_rng(0).normal(size=len(true))
    response = replace(case.estimate.response, ground_acceleration=true + 0.001)
    std = replace(case.estimate.std, ground_acceleration=np.full(len(true), 0.002))
    noise = FoundNoise({"ground_acceleration": np.array([NOISE])})
    estimate = replace(case.estimate, response=response, std=std, noise=noise)
    truth = replace(case.truth, response=replace(case.truth.response, ground_acceleration=true))
    return replace(case, estimate=estimate, record=replace(case.record, ground_acceleration=measured), truth=truth)


def without_estimate(case):
    """The same from an estimator that does not estimate the ground."""
    response = replace(case.estimate.response, ground_acceleration=None)
    std = replace(case.estimate.std, ground_acceleration=None)
    return replace(case, estimate=replace(case.estimate, response=response, std=std, summary={}))


def test_histories_of_the_ground_are_written_where_there_are_any(shaken, make_case):
    dataset = response_dataset(results_of(shaken))
    sources = {
        "": shaken.estimate.response,
        "_std": shaken.estimate.std,
        "_true": shaken.truth.response,
        "_observed": shaken.record,
    }
    for suffix, source in sources.items():
        variable = dataset[f"ground_acceleration{suffix}"]
        np.testing.assert_array_equal(variable, source.ground_acceleration)
        assert variable.dims == ("time",)
        assert variable.attrs["units"] == "m/s^2"
    assert dataset.attrs["frame"] == "absolute"
    case = without_estimate(shaken)
    nothing = Truth(Response.unknown(case.record.time, 3), None)
    names = set(response_dataset(results_of(case, truth=nothing)))
    assert {name for name in names if "ground" in str(name)} == {"ground_acceleration_observed"}
    still = make_case()
    dataset = response_dataset(results_of(still))
    assert not [name for name in dataset if "ground" in str(name)]
    assert "frame" not in dataset.attrs


def test_the_ground_has_a_row_of_residuals(shaken):
    table = residual_table(shaken.estimate, shaken.record, shaken.truth.response)
    row = table.iloc[-1]
    assert (row["quantity"], row["dof"]) == ("ground_acceleration", 0)
    assert table["dof"].tolist() == [1, 2, 1, 0]
    assert row["residual_rms"] == pytest.approx(NOISE, rel=0.1)
    assert row["sigma"] == NOISE
    assert np.isnan(row["free_run_nmse_percent"])
    text = sensors_text([[table]])
    assert "\nground  " in text
    assert "ground_acceleration" not in text


def labels(figure):
    return [axes.get_ylabel() for axes in figure.axes]


def says_ground(axes):
    return any(text.get_text().startswith("Ground acceleration") for text in axes.texts)


def test_figures_show_the_ground(shaken):
    figure = response_figure(results_of(shaken))
    drawn = [axes for axes in figure.axes if says_ground(axes)]
    assert len(drawn) == 1
    styles = {line.get_marker() for line in drawn[0].get_lines()}
    assert "." in styles  # observations
    assert len(drawn[0].get_lines()) == 3  # and truth and estimate
    assert len(drawn[0].collections) == 1  # and the band
    residuals = residuals_figure(shaken.estimate, shaken.record)
    assert labels(residuals)[-3] == r"$\ddot{u}_g$, ground"
    case = without_estimate(shaken)
    figure = response_figure(results_of(case, truth=Truth(Response.unknown(case.record.time, 3), None)))
    (drawn,) = [axes for axes in figure.axes if says_ground(axes)]
    assert len(drawn.get_lines()) == 1
    assert not any("ground" in label for label in labels(residuals_figure(case.estimate, case.record)))


@pytest.mark.parametrize("frame", ["absolute", "relative"])
def test_the_free_run_moves_with_the_ground(make_case, frame):
    frame_of_three = build_chain(3, Linear(), m=[2e3, 2e3, 1.5e3], c=6e3, k=[8e5, 7.2e5, 5.6e5])
    span = {"duration": 20.0, "samples": 1001}
    motion = GroundMotion(3, **span, highest=8.0)
    found = Simulated(motion, Simulation(**span), Noise(30.0), frame).measure(frame_of_three)
    truth = found.truth.response
    estimate = replace(make_case().estimate, response=truth, parameters=[])
    run = free_run(frame_of_three, estimate, found.record)
    assert run.finding == ""
    for quantity in ("displacement", "acceleration"):
        error = getattr(run.response, quantity) - getattr(truth, quantity)
        assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean(getattr(truth, quantity) ** 2))
    wrong = frame_of_three.with_parameters(k=0.7 * frame_of_three.parameters["k"])
    assert "do not reproduce the estimated response" in free_run(wrong, estimate, found.record).finding
