from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf

from pinn_cli.cli.records import data_of_records
from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.settings.instantiation import build

CONF = Path(__file__).parents[2] / "conf" / "data" / "csv.yaml"
SHARED = CONF.with_name("_measured.yaml")
STEP = 0.01
ROWS = 200


def table() -> pd.DataFrame:
    time = np.round(STEP * np.arange(ROWS), 2)
    channels = {name: np.sin((i + 1.0) * time + i) for i, name in enumerate(["f1", "u1", "v2", "a1", "a2", "a3"])}
    return pd.DataFrame({"t (s)": time, **channels})


@pytest.fixture
def rig(tmp_path) -> Path:
    table().to_csv(tmp_path / "rig.csv", index=False)
    return tmp_path


SETTINGS = {
    "path": "rig.csv",
    "time": "t (s)",
    "force": {1: "f1"},
    "displacement": {1: "u1"},
    "velocity": {2: "v2"},
    "acceleration": {1: "a1", 2: "a2", 3: "a3"},
}


def read(base: Path, ndof: int = 4, **changes):
    return MeasuredData(**{**SETTINGS, "base": base, **changes}).measure(ndof)


def test_columns_go_where_the_settings_say(rig):
    record = read(rig).record
    values = table()
    assert record.ndof == 4
    assert record.sampling_rate == pytest.approx(100.0)
    np.testing.assert_allclose(record.time, values["t (s)"], atol=1e-12)
    np.testing.assert_allclose(record.velocity[:, 1], values["v2"], rtol=1e-12)
    np.testing.assert_allclose(record.acceleration[:, 2], values["a3"], rtol=1e-12)
    np.testing.assert_allclose(record.force[:, 0], values["f1"], rtol=1e-12)
    assert record.sensors("displacement").tolist() == [True, False, False, False]
    assert record.sensors("velocity").tolist() == [False, True, False, False]
    assert record.sensors("acceleration").tolist() == [True, True, True, False]
    assert record.unforced.tolist() == [False, True, True, True]
    assert not record.force[:, 1:].any()
    assert record.intersample == "band_limited"


def test_a_held_out_dof_is_in_the_truth_and_nowhere_else(rig):
    measurements = read(rig, holdout=[2])
    record, truth = measurements.record, measurements.truth.response
    values = table()
    assert np.isnan(record.velocity).all()
    assert np.isnan(record.acceleration[:, 1]).all()
    assert record.observed.tolist() == [True, False, True, False]
    np.testing.assert_allclose(truth.velocity[:, 1], values["v2"], rtol=1e-12)
    np.testing.assert_allclose(truth.acceleration[:, 1], values["a2"], rtol=1e-12)
    known = [np.isfinite(getattr(truth, q)).all(axis=0) for q in ("displacement", "velocity", "acceleration", "force")]
    assert np.array(known).sum() == 2
    assert measurements.truth.parameters is None


def test_a_force_that_is_not_measured_is_unknown(rig):
    unmeasured = read(rig, force={1: "f1", 3: None})
    assert np.isnan(unmeasured.record.force[:, 2]).all()
    assert unmeasured.record.unforced.tolist() == [False, True, False, True]
    assert read(rig, force={}).record.unforced.all()


def test_the_window_includes_its_ends_and_keeps_the_files_times(rig):
    record = read(rig, start=0.5, stop=1.2).record
    assert record.time[[0, -1]] == pytest.approx([0.5, 1.2])
    assert len(record.time) == 71
    np.testing.assert_allclose(record.acceleration[:, 0], table()["a1"][50:121], rtol=1e-12)


def test_decimation_filters_force_and_response_alike(rig):
    whole, kept = read(rig).record, read(rig, decimate=4).record
    assert kept.sampling_rate == pytest.approx(25.0)
    np.testing.assert_allclose(kept.time, whole.time[::4])
    for quantity, dof in (("force", 0), ("velocity", 1), ("acceleration", 2)):
        np.testing.assert_allclose(getattr(kept, quantity)[:, dof], getattr(whole, quantity)[::4, dof], atol=5e-3)


def test_trailing_blank_lines_and_columns_that_nobody_asked_for_do_no_harm(rig):
    text = (rig / "rig.csv").read_text().splitlines()
    text = [text[0] + ",note", *(row + ",ok" for row in text[1:])]
    (rig / "rig.csv").write_text("\ufeff" + "\n".join(text) + "\n\n\n")
    assert len(read(rig).record.time) == ROWS


def test_a_gap_outside_the_window_is_no_matter(rig):
    values = table()
    values.loc[150, "a1"] = np.nan
    values.drop(index=range(160, 165)).to_csv(rig / "rig.csv", index=False)
    assert len(read(rig, stop=1.0).record.time) == 101
    assert not read(rig, stop=1.0).record.calibrated
    (channel,) = read(rig, stop=1.55).record.calibrated
    assert (channel.key, len(channel.time)) == ("a1", 155)


@pytest.mark.parametrize("decimals", [3, 4, 6])
def test_times_printed_with_few_digits_are_uniform(rig, decimals):
    values = table()
    values["t (s)"] = np.round(np.arange(ROWS) / 256.0, decimals)
    values.to_csv(rig / "rig.csv", index=False)
    record = read(rig).record
    assert record.sampling_rate == pytest.approx(256.0, rel=1e-3)
    assert np.ptp(np.diff(record.time)) < 1e-12


def test_clock_times_are_uniform(rig):
    values = table()
    values["t (s)"] = [f"{1.7e9 + STEP * row:.2f}" for row in range(ROWS)]
    values.to_csv(rig / "rig.csv", index=False)
    assert read(rig, decimate=2).record.step == pytest.approx(2 * STEP, rel=1e-4)


def test_dofs_may_come_as_text_and_a_missing_map_as_null(rig):
    record = read(rig, acceleration={"1": "a1", "3": "a3"}, displacement=None, velocity={}).record
    assert record.sensors("acceleration").tolist() == [True, False, True, False]


def test_the_config_lists_every_setting_and_reads_the_file(rig):
    of_csv = {name: value for name, value in OmegaConf.load(CONF).items() if name != "defaults"}
    settings = OmegaConf.merge(OmegaConf.load(SHARED), of_csv, {**SETTINGS, "holdout": [2]})
    fields = set(MeasuredData.__dataclass_fields__) - {"base", "responds"}
    assert set(settings) - {"_target_", "records", "window", "overlap"} == fields
    (own,) = data_of_records(settings)
    source = build(own, "data", base=rig)
    assert source.measure(3).record.observed.tolist() == [True, False, True]


def test_cristallo_is_read_by_its_own_settings(shared):
    settings = OmegaConf.to_container(OmegaConf.load(shared / "data" / "cristallo" / "cristallo.yaml"))
    measurements = MeasuredData(**settings, base=shared).measure(3)
    record, truth = measurements.record, measurements.truth.response
    assert len(record.time) == 5001
    assert record.sampling_rate == pytest.approx(250.0)
    assert record.sensors("velocity").tolist() == [True, False, True]
    assert record.sensors("force").tolist() == [True, False, False]
    assert record.unforced.tolist() == [False, True, True]
    assert np.isfinite(truth.velocity[:, 1]).all()
    assert np.isnan(truth.velocity[:, [0, 2]]).all()


@pytest.mark.parametrize("header", ["", ",", ",,"])
@pytest.mark.parametrize("row", ["", ",", ",,"])
def test_rows_may_end_with_commas(rig, header, row):
    expected = read(rig).record
    lines = (rig / "rig.csv").read_text().splitlines()
    (rig / "rig.csv").write_text("\n".join([lines[0] + header, *(line + row for line in lines[1:])]) + "\n")
    record = read(rig).record
    for quantity in ("time", "displacement", "velocity", "acceleration", "force"):
        np.testing.assert_array_equal(getattr(record, quantity), getattr(expected, quantity))
