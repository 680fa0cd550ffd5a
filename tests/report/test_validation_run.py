"""The identified system on other data: its error, its band, its table, text and figure."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from small_estimates import make_estimate
from small_problems import measured, small_chain

from pinn_cli.record.channel import Calibration, Channel
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.record.validation_data import ValidationRecord
from pinn_cli.report.figures.sensors import WITH_NOISE, WITHOUT_NOISE, validation_figure
from pinn_cli.report.free_run import ValidationRun, validation_table
from pinn_cli.report.text import validation_text
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.estimate import Estimate, ParameterEstimate
from pinn_cli.training.found_noise import FoundNoise

Z = 1.6448536


def estimated(structure, record, error: float, std: float, sigma: float = 0.0) -> Estimate:
    """Stiffnesses all off by a share, and how far they are believed to be."""
    parameters = [
        ParameterEstimate(p, v := (1 + error) * p.prescribed, s := std * p.prescribed, v - Z * s, v + Z * s)
        for p in structure.every_parameter()
        if p.kind == "k"
    ]
    n = structure.ndof
    levels = {"acceleration": sigma, "displacement": np.nan, "force": np.nan}
    noise = FoundNoise({quantity: np.full(n, level) for quantity, level in levels.items()})
    none = replace(make_estimate().estimate.std, **{q: np.zeros((len(record.time), n)) for q in RESPONSE_QUANTITIES})
    return replace(make_estimate().estimate, parameters=parameters, correlation=np.ones((n, n)), noise=noise, std=none)


def tried(error: float = 0.0, std: float = 0.05, nonlinearity: str = "duffing", sigma: float = 0.0):
    structure = small_chain(nonlinearity)
    measurements = measured(structure)
    record = measurements.record.keep({"acceleration": [1, 3]})
    random = np.random.default_rng(0)
    record = replace(record, acceleration=record.acceleration + sigma * random.standard_normal((257, 3)))
    estimate = estimated(structure, record, error, std, sigma)
    data = ValidationRecord(record, 20, None)
    return structure, estimate, record, data


def table_of(**settings: float) -> pd.DataFrame:
    structure, estimate, record, data = tried(**settings)
    return validation_table(ValidationRun.of(structure, estimate, record, data), estimate)


def test_the_right_system_makes_no_error():
    table = table_of()
    assert table[["quantity", "dof", "unit", "begins"]].values.tolist() == [
        ["acceleration", 1, "m/s^2", "rest"], ["acceleration", 3, "m/s^2", "rest"],
    ]  # fmt: skip
    assert (table["samples"] == 257 - 20).all()
    assert (table["nmse_percent"] < 1e-4).all()
    assert (table["start_time"] == measured(small_chain()).record.time[20]).all()


def test_an_error_of_the_size_that_is_believed_lies_in_the_band():
    inside = []
    for error in (-0.08, -0.05, -0.02, 0.02, 0.05, 0.08):
        table = table_of(error=error)
        assert table["nmse_percent"].between(0.05, 30.0).all()
        inside += table["inside_95_percent"].tolist()
    assert np.mean(inside) > 90.0
    assert (table_of(error=0.05, std=0.005)["inside_95_percent"] < 50.0).all()


def test_the_discrepancy_and_the_load_cell_widen_the_band():
    structure, estimate, record, data = tried(std=1e-6)
    plain = ValidationRun.of(structure, estimate, record, data)
    cells = {"force": np.array([0.2, np.nan, np.nan])}
    wide, cell = (
        ValidationRun.of(structure, replace(estimate, noise=noise), record, data)
        for noise in (FoundNoise(cells, 0.1), FoundNoise(cells))
    )
    for dof in range(3):
        assert np.mean(wide.std.displacement[50:, dof]) > np.mean(cell.std.displacement[50:, dof])
        assert np.mean(cell.std.displacement[50:, dof]) > 10.0 * np.mean(plain.std.displacement[50:, dof])


def test_it_begins_where_the_estimate_was():
    structure = small_chain("linear")
    measurements = measured(structure)
    record, truth = measurements.record.keep({"acceleration": [2]}), measurements.truth.response
    estimate = replace(estimated(structure, record, 0.0, 0.01), response=truth)
    later = replace(record, **{name: getattr(record, name)[100:] for name in ("time", *RESPONSE_QUANTITIES, "force")})
    run = ValidationRun.of(structure, estimate, record, ValidationRecord(later, 10, 100))
    assert validation_table(run, estimate)["begins"].tolist() == ["estimate"]
    assert validation_table(run, estimate)["nmse_percent"][0] < 1e-3
    from_rest = ValidationRun.of(structure, estimate, record, ValidationRecord(later, 10, None))
    assert validation_table(from_rest, estimate)["nmse_percent"][0] > 1.0
    uncertain = replace(estimate, std=replace(estimate.std, displacement=np.full((257, 3), 0.01)))
    wide = ValidationRun.of(structure, uncertain, record, ValidationRecord(later, 10, 100))
    np.testing.assert_allclose(wide.std.displacement[0], 0.01, rtol=0.35)


def test_a_load_cell_s_gain_that_was_found_is_used():
    structure, estimate, record, _ = tried()
    cell = Channel("f", "force", {0: 1.0}, record.time, 1.25 * record.force[:, 0],
                 {"gain": Calibration(1.0, 10.0, unknown=True)})  # fmt: skip
    shown = replace(record, force=1.25 * record.force, calibrated=(cell,))
    gain = ParameterEstimate(Parameter("gain", 0, 1.0, label="f"), 1.25, 0.001, 1.248, 1.252)
    parameters = [*estimate.parameters, gain]
    with_gain = replace(estimate, parameters=parameters, correlation=np.eye(4))
    run = ValidationRun.of(structure, with_gain, record, ValidationRecord(shown, 20, None))
    assert (validation_table(run, with_gain)["nmse_percent"] < 1e-4).all()


def test_what_a_tilt_that_was_found_adds_is_no_error():
    structure = small_chain("duffing")
    measurements = measured(structure)
    record, truth = measurements.record.keep({"acceleration": [1, 3]}), measurements.truth.response
    felt = truth.acceleration[:, 0] + 3.0 * truth.displacement[:, 0]
    unknown = {"tilt": Calibration(0.0, 40.0, unknown=True)}
    tilts = Channel("a1", "acceleration", {0: 1.0}, record.time, felt, unknown)
    shown = replace(record, acceleration=np.where([True, False, False], tilts.measured[:, None], record.acceleration))
    tilt = ParameterEstimate(Parameter("tilt", 0, 0.0, label="a1"), 3.0, 0.001, 2.998, 3.002)
    estimate = estimated(structure, record, 0.0, 0.01)
    found = replace(estimate, parameters=[*estimate.parameters, tilt], correlation=np.eye(4))
    data = ValidationRecord(replace(shown, calibrated=(tilts,)), 20, None)
    assert (validation_table(ValidationRun.of(structure, found, record, data), found)["nmse_percent"] < 1e-3).all()


def test_without_deviations_there_is_no_band():
    structure, estimate, record, data = tried()
    blank = replace(estimate, correlation=None)
    run = ValidationRun.of(structure, blank, record, data)
    table = validation_table(run, blank)
    assert run.std is None
    assert table[["band_rms", "inside_95_percent"]].isna().all(axis=None)
    assert "acceleration 3" in validation_text(run, table)
    assert "inside" not in validation_text(run, table).splitlines()[0]
    assert len(validation_figure(run, blank).axes) == 4


def test_the_noise_of_a_sensor_that_was_held_out_is_unknown():
    structure, estimate, record, data = tried(sigma=0.1)
    held_out = replace(estimate, noise=FoundNoise({"acceleration": np.array([0.1, np.nan, np.nan])}))
    run = ValidationRun.of(structure, held_out, record, data)
    figure = validation_figure(run, held_out)
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts[-2:] == [WITH_NOISE, WITHOUT_NOISE]
    figure.draw_without_rendering()
    extent = figure.legends[0].get_window_extent()
    assert 0.0 < extent.x0 < extent.x1 < figure.bbox.x1


def test_a_system_that_runs_away_is_told():
    structure, estimate, record, data = tried(error=-3.0)
    run = ValidationRun.of(structure.linearised(), estimate, record, data)
    stiff = ValidationRun.of(structure, estimated(structure, record, 1e9, 0.01), record, data)
    assert stiff.response is None
    assert "too stiff" in validation_text(stiff, validation_table(stiff, estimate))
    assert run.finding == "" or "unstable" in run.finding


@pytest.mark.parametrize("draws", [30, 500])
def test_draws_of_a_posterior_make_the_band(draws):
    structure, estimate, record, data = tried()
    values = np.array([p.estimate for p in estimate.parameters])
    wide = values * (1.0 + 0.1 * np.random.default_rng(0).standard_normal((draws, 1)))
    run = ValidationRun.of(structure, estimate, record, data, wide)
    own = ValidationRun.of(structure, estimate, record, data)
    ratio = np.mean(run.std.displacement[50:]) / np.mean(own.std.displacement[50:])
    assert 1.4 < ratio < 2.8
