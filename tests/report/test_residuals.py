"""What is left of every sensor: the table against numbers counted by hand, and the figure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pinn_cli.record.channels import clipped_percent, constant_percent
from pinn_cli.record.gauge import Gauge
from pinn_cli.report.figures import residuals_figure
from pinn_cli.report.residuals import COLUMNS, residual_table
from pinn_cli.system.quantities import CONNECTION_FORCE

NOISE = 0.05


def noisy(case, seed=0):
    """The case's record with white noise of 0.05 m/s^2 on its accelerometers, of 0.1 N on its load cell."""
    rng, record = np.random.default_rng(seed), case.record
    shape = record.acceleration.shape
    acceleration = case.truth.response.acceleration + NOISE * rng.normal(size=shape)
    force = np.where(record.unforced, 0.0, record.force + 0.1 * rng.normal(size=shape))
    return replace(record, acceleration=np.where(record.observed, acceleration, np.nan), force=force)


def exact(case, **summary):
    return replace(case.estimate, response=case.truth.response, summary=summary)


def test_a_row_for_every_sensor_and_none_for_a_force_that_is_known_to_be_zero(make_case):
    case = make_case(ndof=3, observed=2)
    table = residual_table(case.estimate, case.record)
    assert list(table) == list(COLUMNS)
    expected = [("acceleration", 1), ("acceleration", 2), ("force", 1)]
    assert list(table[["quantity", "dof"]].itertuples(index=False, name=None)) == expected


def test_a_row_for_sensors_that_fill_no_column(make_case):
    """A strain, and the force of a connection: the estimate says what they would have felt."""
    case = make_case(ndof=2, observed=2, samples=2000)
    rng, truth = np.random.default_rng(4), case.truth.response
    truth = replace(truth, connection_force=np.stack((truth.displacement[:, 0], truth.displacement[:, 1]), axis=1))
    own, empty = case.record.time, np.zeros(0)
    gauges = (
        Gauge("strain", "displacement", {0: 0.4, 1: -0.2}, own, empty),
        Gauge("link", CONNECTION_FORCE, {}, own, empty, connection=1),
    )
    felt = 0.4 * truth.displacement[:, 0] - 0.2 * truth.displacement[:, 1], truth.displacement[:, 1]
    size = [0.01 * np.std(x) for x in felt]
    shown = {
        gauge.name: (x + sigma * rng.normal(size=len(own)), np.ones(len(own), bool))
        for gauge, x, sigma in zip(gauges, felt, size, strict=True)
    }
    record = replace(case.record, gauges=gauges, beside=shown)
    estimate = replace(case.estimate, response=truth, summary={"sigma_gauge": size})
    table = residual_table(estimate, record, truth).iloc[-2:]
    assert table["dof"].isna().all()
    assert list(table["channel"]) == ["displacement of sensor strain", "connection_force of sensor link"]
    np.testing.assert_allclose(table["residual_rms"], size, rtol=0.06)
    np.testing.assert_allclose(table["residual_over_sigma"].astype(float), 1.0, atol=0.06)
    np.testing.assert_allclose(table["free_run_nmse_percent"], table["nmse_percent"])


def test_what_a_perfect_estimate_leaves_is_the_noise(make_case):
    case = make_case(ndof=3, observed=2, samples=2000)
    sigma = {"sigma_acceleration": [NOISE, NOISE, None], "sigma_force": [0.1, None, None]}
    record = noisy(case)
    table = residual_table(exact(case, **sigma), record, case.truth.response)
    np.testing.assert_allclose(table["residual_rms"], [NOISE, NOISE, 0.1], rtol=0.06)
    np.testing.assert_allclose(table["sigma"], [NOISE, NOISE, 0.1])
    np.testing.assert_allclose(table["residual_over_sigma"], 1.0, atol=0.06)
    signal = record.acceleration[:, 0]
    left = signal - case.truth.response.acceleration[:, 0]
    first = table.iloc[0]
    assert first["nmse_percent"] == pytest.approx(100.0 * np.mean(left**2) / np.var(signal))
    assert first["signal_rms"] == pytest.approx(np.std(signal))
    assert first["mean_residual"] == pytest.approx(np.mean(left))
    assert first["free_run_nmse_percent"] == pytest.approx(first["nmse_percent"])
    assert np.isnan(table["free_run_nmse_percent"].iloc[2])
    assert table["whiteness"].min() > 0.01
    assert table["largest_autocorrelation"].abs().max() < 0.1
    assert table["clipped_percent"].max() == table["constant_percent"].max() == 0.0


def test_a_wrong_estimate_leaves_what_is_not_white(make_case):
    case = make_case(ndof=2, observed=2, samples=2000)
    wrong = replace(case.truth.response, acceleration=0.5 * case.truth.response.acceleration)
    table = residual_table(replace(case.estimate, response=wrong), noisy(case))
    seen = table[table["quantity"] == "acceleration"]
    np.testing.assert_allclose(seen["nmse_percent"], 25.0, atol=1.5)
    assert seen["whiteness"].max() < 1e-6
    assert seen["spectrum_deviation"].min() > 0.5
    assert seen["largest_autocorrelation"].min() > 0.5


@pytest.mark.parametrize("summary", [{}, {"sigma_acceleration": [None, None]}, {"sigma_acceleration": 0.3}])
def test_without_a_noise_level_its_cells_are_empty(summary, make_case):
    case = make_case(ndof=2, observed=1)
    table = residual_table(exact(case, **summary), noisy(case))
    assert table[["sigma", "residual_over_sigma", "free_run_nmse_percent"]].isna().all(axis=None)


def test_a_dead_sensor_has_no_nmse_and_is_constant(make_case):
    case = make_case(ndof=2, observed=2)
    dead = case.record.acceleration.copy()
    dead[:, 0] = 0.0
    table = residual_table(case.estimate, replace(case.record, acceleration=dead))
    first = table.iloc[0]
    assert np.isnan(first[["nmse_percent", "band_low_hz", "band_high_hz"]].to_numpy(dtype=float)).all()
    assert (first["constant_percent"], first["band_share_percent"]) == (100.0, 0.0)
    assert table["constant_percent"].iloc[1] == 0.0


def rows(figure):
    return np.array(figure.axes).reshape(-1, 3)


def test_the_figure_has_a_row_for_every_sensor_with_its_noise(make_case):
    case = make_case(ndof=3, observed=2, samples=400)
    estimate = replace(case.estimate, summary={"sigma_acceleration": [0.02, None, None]})
    figure = residuals_figure(estimate, case.record)
    labels = [row[0].get_ylabel() for row in rows(figure)]
    assert labels == [r"$\ddot{u}$, DOF 1", r"$\ddot{u}$, DOF 2", "$f$, DOF 1"]
    left = case.record.acceleration[:, 0] - case.estimate.response.acceleration[:, 0]
    history, spectrum, correlation = rows(figure)[0]
    assert history.get_title(loc="left") == "(mm/s²)"
    np.testing.assert_allclose(history.lines[0].get_ydata(), 1e3 * left)
    assert sorted(line.get_ydata()[0] for line in history.lines[1:]) == pytest.approx([-39.2, 39.2])
    assert spectrum.lines[2].get_ydata()[0] == pytest.approx(0.02**2)
    assert len(rows(figure)[1][1].lines) == 2
    assert correlation.patches[0].get_y() == pytest.approx(-1.96 / 20.0)  # of white noise, by the samples
    assert correlation.patches[0].get_height() == pytest.approx(2.0 * 1.96 / 20.0)
    legends = [each.legends[0].get_texts() for each in (figure, residuals_figure(case.estimate, case.record))]
    assert [any("noise found" in text.get_text() for text in texts) for texts in legends] == [True, False]


def test_of_many_sensors_the_worst_are_drawn_and_counted(make_case):
    case = make_case(ndof=12, observed=12)
    acceleration = case.record.acceleration.copy()
    acceleration[:, [3, 10]] += 5.0
    figure = residuals_figure(case.estimate, replace(case.record, acceleration=acceleration))
    labels = [row[0].get_ylabel() for row in rows(figure)]
    assert len(labels) == 8
    assert {r"$\ddot{u}$, DOF 4", r"$\ddot{u}$, DOF 11"} <= set(labels)
    assert ["8 of 13" in text.get_text() for text in figure.texts] == [True]


@pytest.mark.parametrize("signal", [0.0, 1.0])
def test_a_dead_sensor_and_an_exact_estimate_can_be_drawn(signal, make_case):
    case = make_case(ndof=1, observed=1)
    record = replace(case.record, acceleration=signal * case.truth.response.acceleration)
    response = replace(case.truth.response, acceleration=record.acceleration)
    residuals_figure(replace(case.estimate, response=response), record).draw_without_rendering()


def test_clipping_is_counted_where_more_than_two_samples_sit_at_an_end():
    wave = np.sin(np.linspace(0.0, 40.0, 1000))
    assert clipped_percent(wave) == 0.0
    flat = np.clip(wave, -0.9, 2.0)
    assert clipped_percent(flat) == pytest.approx(100.0 * np.mean(wave <= -0.9))
    hammer = np.zeros(1000)
    hammer[100:110] = np.arange(1.0, 11.0)
    assert clipped_percent(hammer) == 0.0


def test_runs_of_equal_samples_are_constant_from_eight_on():
    values = np.random.default_rng(0).normal(size=100)
    values[10:17] = 1.0
    assert constant_percent(values) == 0.0
    values[17] = 1.0
    assert constant_percent(values) == 8.0
    values[50:70] = 0.0
    assert constant_percent(values) == 28.0
