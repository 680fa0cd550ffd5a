"""Both fitness formulas, the table of what is left of every sensor and its figure, against numbers counted by hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstwo

from pinn_cli.record.channel import CALIBRATED, Channel
from pinn_cli.record.checks import clipped_percent, constant_percent
from pinn_cli.record.response import QUANTITIES
from pinn_cli.report.figures.sensors import compared_channels, residuals_figure
from pinn_cli.report.fitness import (
    MANY,
    autocorrelation,
    both_formulas,
    cumulated_deviation,
    cumulated_periodogram,
    exceeded,
    fitness_percent,
    fitness_table,
    residual_table,
    white_probability,
)
from pinn_cli.system.quantities import CONNECTION_FORCE
from pinn_cli.training.noise_model import FoundNoise

SIGNALS = Path(__file__).resolve().parents[3] / "shared" / "data" / "reference_signals"
NOISE = 0.05


def by_range(estimate, truth):
    return both_formulas(estimate, truth)[1]


def test_values_worked_out_by_hand():
    truth = np.array([[0.0, 1.0], [2.0, 1.0], [4.0, 1.0]])
    estimate = np.array([[1.0, 1.0], [2.0, 1.0], [4.0, 1.0]])
    # error norm 1, norm of the deviation from the mean sqrt(8); RMSE sqrt(1/3), range 4; the second DOF is constant
    np.testing.assert_allclose(fitness_percent(estimate, truth), [100 * (1 - 1 / np.sqrt(8)), np.nan])
    np.testing.assert_allclose(by_range(estimate, truth), [100 * (1 - np.sqrt(1 / 3) / 4), np.nan])


@pytest.mark.parametrize("formula", [fitness_percent, by_range])
def test_unknown_samples_are_left_out_and_a_perfect_estimate_scores_100(formula, make_case):
    truth = make_case().truth.response.velocity
    np.testing.assert_array_equal(formula(truth, truth), 100.0)
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


def test_group_averages_go_over_the_filled_cells_and_gaps_are_refused(make_case):
    case = make_case(ndof=4, observed=2)
    table = fitness_table(case.estimate.response, case.truth.response, case.record.observed)
    cells = table.set_index(["group", "quantity"])["fitness_percent"]
    by_dof = [cells[f"dof_{dof}", "velocity"] for dof in range(1, 5)]
    averages = {"all": by_dof, "observed": by_dof[:2], "unobserved": by_dof[2:]}
    assert {group: cells[group, "velocity"] for group in averages} == pytest.approx(
        {group: np.mean(own) for group, own in averages.items()}
    )
    assert cells["all", "force"] == cells["first", "force"] == cells["dof_1", "force"]
    assert all(np.isnan(cells[group, "force"]) for group in ("dof_2", "last", "unobserved"))
    case = make_case()
    estimate = replace(case.estimate.response, force=np.full_like(case.record.force, np.nan))
    table = fitness_table(estimate, case.truth.response, case.record.observed)
    assert table.loc[table["quantity"] == "force", "fitness_percent"].isna().all()
    estimate.velocity[5, 2] = np.inf
    with pytest.raises(ValueError, match="velocity of DOF 3 is not finite"):
        fitness_table(estimate, case.truth.response, case.record.observed)


def noisy(case, seed=0):
    """The case's record with white noise of 0.05 m/s^2 on its accelerometers, of 0.1 N on its load cell."""
    rng, record = np.random.default_rng(seed), case.record
    shape = record.acceleration.shape
    acceleration = case.truth.response.acceleration + NOISE * rng.normal(size=shape)
    force = np.where(record.unforced, 0.0, record.force + 0.1 * rng.normal(size=shape))
    return replace(record, acceleration=np.where(record.observed, acceleration, np.nan), force=force)


def exact(case, noise):
    return replace(case.estimate, response=case.truth.response, noise=noise)


def test_what_a_perfect_estimate_leaves_is_the_noise(make_case):
    case = make_case(ndof=3, observed=2, samples=2000)
    nan = np.nan
    noise = FoundNoise({"acceleration": np.array([NOISE, NOISE, nan]), "force": np.array([0.1, nan, nan])})
    record = noisy(case)
    table = residual_table(exact(case, noise), record, case.truth.response)
    # None of a force that is known to be zero.
    sensors = [("acceleration", 1), ("acceleration", 2), ("force", 1)]
    assert list(table[["quantity", "dof"]].itertuples(index=False, name=None)) == sensors
    np.testing.assert_allclose(table["residual_rms"], [NOISE, NOISE, 0.1], rtol=0.06)
    np.testing.assert_allclose(table["sigma"], [NOISE, NOISE, 0.1])
    np.testing.assert_allclose(table["residual_over_sigma"], 1.0, atol=0.06)
    signal = record.acceleration[:, 0]
    left, first = signal - case.truth.response.acceleration[:, 0], table.iloc[0]
    assert first["nmse_percent"] == pytest.approx(100.0 * np.mean(left**2) / np.var(signal))
    assert first["signal_rms"] == pytest.approx(np.std(signal))
    assert first["mean_residual"] == pytest.approx(np.mean(left))
    assert first["free_run_nmse_percent"] == pytest.approx(first["nmse_percent"])
    assert np.isnan(table["free_run_nmse_percent"].iloc[2])
    assert table["whiteness"].min() > 0.01
    assert table["largest_autocorrelation"].abs().max() < 0.1
    assert table["clipped_percent"].max() == table["constant_percent"].max() == 0.0


def test_a_row_for_sensors_that_fill_no_column(make_case):
    """A strain, and the force of a connection: the estimate says what they would have felt."""
    case = make_case(ndof=2, observed=2, samples=2000)
    rng, truth = np.random.default_rng(4), case.truth.response
    truth = replace(truth, connection_force=np.stack((truth.displacement[:, 0], truth.displacement[:, 1]), axis=1))
    own, empty = case.record.time, np.zeros(0)
    calibrated = (
        Channel("strain", "displacement", {0: 0.4, 1: -0.2}, own, empty),
        Channel("link", CONNECTION_FORCE, {}, own, empty, connection=1),
    )
    felt = 0.4 * truth.displacement[:, 0] - 0.2 * truth.displacement[:, 1], truth.displacement[:, 1]
    size = [0.01 * np.std(x) for x in felt]
    record = replace(case.record, calibrated=calibrated)
    shown = [x + sigma * rng.normal(size=len(own)) for x, sigma in zip(felt, size, strict=True)]
    record = replace(record, corrected=tuple(c.at(own, x) for c, x in zip(record.calibrated, shown, strict=True)))
    estimate = replace(case.estimate, response=truth, noise=FoundNoise({CALIBRATED: np.array(size)}))
    table = residual_table(estimate, record, truth).iloc[-2:]
    assert table["dof"].isna().all()
    assert list(table["channel"]) == ["displacement of sensor strain", "connection_force of sensor link"]
    np.testing.assert_allclose(table["residual_rms"], size, rtol=0.06)
    np.testing.assert_allclose(table["residual_over_sigma"].astype(float), 1.0, atol=0.06)
    np.testing.assert_allclose(table["free_run_nmse_percent"], table["nmse_percent"])


def test_a_wrong_estimate_leaves_what_is_not_white(make_case):
    case = make_case(ndof=2, observed=2, samples=2000)
    wrong = replace(case.truth.response, acceleration=0.5 * case.truth.response.acceleration)
    table = residual_table(replace(case.estimate, response=wrong), noisy(case))
    seen = table[table["quantity"] == "acceleration"]
    np.testing.assert_allclose(seen["nmse_percent"], 25.0, atol=1.5)
    assert seen["whiteness"].max() < 1e-6
    assert seen["spectrum_deviation"].min() > 0.5
    assert seen["largest_autocorrelation"].min() > 0.5


@pytest.mark.parametrize("sensors", [{}, {"acceleration": np.full(2, np.nan)}])
def test_without_a_noise_level_its_cells_are_empty(sensors, make_case):
    case = make_case(ndof=2, observed=1)
    table = residual_table(exact(case, FoundNoise(sensors)), noisy(case))
    assert table[["sigma", "residual_over_sigma", "free_run_nmse_percent"]].isna().all(axis=None)


@pytest.mark.parametrize("signal", [0.0, 1.0])
def test_a_dead_sensor_and_an_exact_estimate_have_a_row_and_nothing_to_draw(signal, make_case):
    case = make_case(ndof=1, observed=1)
    record = replace(case.record, acceleration=signal * case.truth.response.acceleration)
    estimate = replace(case.estimate, response=replace(case.truth.response, acceleration=record.acceleration))
    first = residual_table(estimate, record).iloc[0]
    known = first[["nmse_percent", "band_low_hz", "band_high_hz"]].to_numpy(dtype=float)
    assert np.isfinite(known).all() == (signal == 1.0)
    assert first["constant_percent"] == (100.0 if signal == 0.0 else 0.0)
    assert compared_channels(estimate, record) == []


def test_the_figure_has_a_row_for_every_sensor_with_its_noise(make_case):
    case = make_case(ndof=3, observed=2, samples=400)
    estimate = replace(case.estimate, noise=FoundNoise({"acceleration": np.array([0.02, np.nan, np.nan])}))
    figure = residuals_figure(estimate, case.record)
    rows = np.array(figure.axes).reshape(-1, 3)
    assert [row[0].get_ylabel() for row in rows] == [r"$\ddot{u}$, DOF 1", r"$\ddot{u}$, DOF 2", "$f$, DOF 1"]
    left = case.record.acceleration[:, 0] - case.estimate.response.acceleration[:, 0]
    history, spectrum, correlation = rows[0]
    assert history.get_title(loc="left") == "(mm/s²)"
    np.testing.assert_allclose(history.lines[0].get_ydata(), 1e3 * left)
    assert sorted(line.get_ydata()[0] for line in history.lines[1:]) == pytest.approx([-39.2, 39.2], rel=1e-4)
    assert spectrum.lines[2].get_ydata()[0] == pytest.approx(0.02**2)
    assert correlation.patches[0].get_y() == pytest.approx(-1.96 / 20.0, rel=1e-4)  # of white noise, by the samples
    many = make_case(ndof=12, observed=12)
    acceleration = many.record.acceleration.copy()
    acceleration[:, [3, 10]] += 5.0
    figure = residuals_figure(many.estimate, replace(many.record, acceleration=acceleration))
    labels = [row[0].get_ylabel() for row in np.array(figure.axes).reshape(-1, 3)]
    assert len(labels) == 8
    assert {r"$\ddot{u}$, DOF 4", r"$\ddot{u}$, DOF 11"} <= set(labels)


def test_clipping_is_counted_where_more_than_two_samples_sit_at_an_end_and_equal_ones_from_eight_on():
    wave = np.sin(np.linspace(0.0, 40.0, 1000))
    assert clipped_percent(wave) == 0.0
    assert clipped_percent(np.clip(wave, -0.9, 2.0)) == pytest.approx(100.0 * np.mean(wave <= -0.9))
    hammer = np.zeros(1000)
    hammer[100:110] = np.arange(1.0, 11.0)
    assert clipped_percent(hammer) == 0.0
    values = np.random.default_rng(0).normal(size=100)
    values[10:17] = 1.0
    assert constant_percent(values) == 0.0
    values[17], values[50:70] = 1.0, 0.0
    assert constant_percent(values) == 28.0


@pytest.mark.parametrize("samples", [16, 1024])
def test_of_white_noise_every_probability_is_as_likely_as_any_other(samples):
    rng = np.random.default_rng(samples)
    found = np.sort([white_probability(rng.normal(size=samples)) for _ in range(2000)])
    np.testing.assert_allclose(found, np.linspace(0.0, 1.0, 2000), atol=0.04)
    noise = rng.normal(size=1001)
    for coefficient in (-0.4, 0.4):  # noise with a memory is not white
        assert white_probability(noise[1:] + coefficient * noise[:-1]) < 1e-6


@pytest.mark.parametrize("chance", [0.9, 0.5, 0.05, 1e-3, 1e-5])
@pytest.mark.parametrize("shares", [MANY, 20_000])
def test_the_limit_for_many_shares_is_right_to_a_hundredth(chance, shares):
    assert exceeded(kstwo.isf(chance, shares), shares) == pytest.approx(chance, rel=0.01)


def test_periodogram_and_autocorrelation_are_those_of_their_definitions():
    sine = np.sin(2.0 * np.pi * np.arange(200) * 0.1)
    np.testing.assert_allclose(cumulated_periodogram(sine)[[18, 19, 98]], [0.0, 1.0, 1.0], atol=1e-12)
    assert cumulated_deviation(sine) == pytest.approx(0.8, abs=0.02)
    np.testing.assert_allclose(autocorrelation(np.array([1.0, -1.0, 2.0, -2.0]), 5), [-0.7, 0.4, -0.2, 0.0, 0.0])
    assert np.isnan(white_probability(np.ones(50)))
    assert np.isnan(autocorrelation(np.ones(50), 3)).all()
