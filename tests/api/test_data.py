"""Data in memory are read as a file with the same columns: the same checks, units, identity and numbers."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pint
import pytest
import xarray as xr

from pinn_cli import InputError, Record, Structure, load, run
from pinn_cli.api.data import settings_of
from pinn_cli.api.sep005 import is_sep005, response_as_sep005, table_of_sep005
from pinn_cli.cli.composing import compose_config
from pinn_cli.cli.config import RunConfig
from pinn_cli.record import record
from pinn_cli.record.files.frame import table_of
from pinn_cli.system.quantities import UNITS

STEP, SAMPLES = 0.02, 400
CHAIN = (
    "system=linear", "system.ndof=2", "system.m=10", "system.c=[5,5]", "system.k=[4e3,3e3]", "figures=false",
)  # fmt: skip


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def simulated() -> Record:
    structure = Structure.chain(m=10.0, c=5.0, k=[4e3, 3e3])
    time = STEP * np.arange(SAMPLES)
    force = sum(np.sin(2.0 * np.pi * f * time + f) for f in (0.7, 1.9, 3.1, 4.7))
    return structure.simulate(time, {2: 20.0 * np.asarray(force)}).keep({"acceleration": [1, 2]}).with_noise(40.0, 3)


@pytest.fixture(scope="module")
def frame(simulated: Record) -> pd.DataFrame:
    return simulated.to_frame()


def settings(data: object, *overrides: str) -> list[str]:
    with settings_of(data, overrides) as found:
        return found


def measured(data: object) -> record.Record:
    """What the estimator would be given."""
    with settings_of(data, ()) as found:
        maps = [re.sub(r"^(?=[\w.]+=\{)", "++", override) for override in found]
        config = RunConfig.read(compose_config([*CHAIN, *maps]))
        return config.source.measurements(config.structure)[0].record


@pytest.mark.slow
def test_a_frame_and_a_file_are_one_run_which_goes_on_with_the_same_frame_alone(frame: pd.DataFrame) -> None:
    frame.rename(columns={"acceleration.1": "a1"}).to_csv("rig.csv", index=False, float_format="%.17g")
    columns = ("data.acceleration={1: a1, 2: acceleration.2}", "data.force={2: force.2}")
    of_file = run(*CHAIN, "data=csv", "data.path=rig.csv", *columns, "data.intersample=band_limited", keep=False)
    of_frame = run(*CHAIN, "data.intersample=band_limited", data=frame, directory="done")
    np.testing.assert_array_equal(of_frame.response["displacement"], of_file.response["displacement"])
    pd.testing.assert_frame_equal(of_frame.residuals, of_file.residuals)

    (of_frame.directory / "run.json").unlink()
    other = frame.assign(**{"acceleration.1": 2.0 * frame["acceleration.1"]})
    for data in (None, other):
        with pytest.raises(InputError, match=r"data.path=frame-\w+: must be a frame that this process holds"):
            run("resume=done", data=data)
    again = run("resume=done", data=frame.copy())
    assert again.parameters.equals(load("done").parameters)


def test_a_frame_a_record_and_arrays_are_one_record(simulated: Record, frame: pd.DataFrame) -> None:
    expected = measured(frame)
    for data in (simulated, {name: frame[name].to_numpy() for name in frame}):
        found = measured(data)
        for name in ("time", "acceleration", "force", "unforced"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_columns_are_named_by_what_they_measure(simulated: Record, frame: pd.DataFrame) -> None:
    table = table_of(frame)
    found = settings(frame)
    assert found[:2] == ["data=frame", f"data.path='{table.path.name}'"]
    assert set(found[2:]) == {
        "data.time='t'", "data.force={2: 'force.2'}", "data.acceleration={1: 'acceleration.1', 2: 'acceleration.2'}",
    }  # fmt: skip
    names = {"time (s)": [0.0], "velocity_3 [mm/s]": [0.0], "force roof": [0.0], "displacement.roof": [1.0], "u": [0.0]}
    found = settings(names)
    assert "data.time='time (s)'" in found
    assert "data.velocity={3: 'velocity_3 [mm/s]'}" in found
    assert "data.displacement={roof: 'displacement.roof'}" in found
    assert not any("force" in setting for setting in found)
    assert "data.ground_acceleration='ground_acceleration'" in settings({"ground_acceleration": [0.0]})
    assert "data.force={2: null}" in settings(simulated.without_load_cells())
    # Overrides that name columns are alone.
    found = settings(frame, "data.acceleration={1: acceleration.2}", "data.sampling_rate=50")
    assert found == ["data=frame", f"data.path='{table.path.name}'"]


@pytest.mark.slow
def test_several_frames_are_several_records(frame: pd.DataFrame) -> None:
    shorter = frame.iloc[:300].drop(columns="acceleration.1")
    result = run(*CHAIN, data=[frame, shorter], keep=False)
    assert result.table("records")["samples"].tolist() == [400, 300]


def test_times_may_be_the_index_and_columns_matrices() -> None:
    for index in (
        pd.Index([0.0, 0.5, 1.0]),
        pd.to_timedelta([0, 500, 1000], unit="ms"),
        pd.date_range("2026-01-01", periods=3, freq="500ms"),
    ):
        table = table_of(pd.DataFrame({"a": [1, 2, 3]}, index=index))
        np.testing.assert_allclose(table.columns["t"], [0.0, 0.5, 1.0])
    assert "t" not in table_of(pd.DataFrame({"a": [1, 2, 3]})).columns
    table = table_of({"acceleration": np.arange(6.0).reshape(3, 2)})
    np.testing.assert_array_equal(table.columns["acceleration.2"], [1.0, 3.0, 5.0])
    frame = pd.DataFrame({("force", 1): [1.0], ("force", 2): [2.0]})
    assert list(table_of(frame).columns) == ["force.1", "force.2"]
    table = table_of(pd.DataFrame({"a": ["1.5", "off", None, True]}))
    np.testing.assert_array_equal(table.columns["a"], [1.5, np.nan, np.nan, np.nan])
    assert table.odd_cells["a"] == {1: "off", 3: "True"}
    with pytest.raises(InputError, match=r"column 'a', sample 2=.*off"):
        table.numbers("a")


def test_units_are_kept(frame: pd.DataFrame) -> None:
    g = 9.80665
    in_g = (frame[["acceleration.1", "acceleration.2"]] / g).add_suffix(" (g)")
    named = pd.concat([frame[["t", "force.2"]], in_g], axis="columns")
    told = frame.assign(**{f"acceleration.{i}": frame[f"acceleration.{i}"] / g for i in (1, 2)})
    told.attrs["units"] = {"acceleration.1": "g", "acceleration.2": "g"}
    unit = pint.UnitRegistry().Unit("g_0")
    quantities = {name: frame[name].to_numpy() for name in ("t", "force.2")}
    quantities |= {f"acceleration.{i}": told[f"acceleration.{i}"].to_numpy() * unit for i in (1, 2)}
    expected = measured(frame)
    for data in (named, told, quantities):
        found = measured(data)
        np.testing.assert_allclose(found.acceleration, expected.acceleration, rtol=1e-12)
        np.testing.assert_array_equal(found.force, expected.force)


def test_the_name_says_the_content(frame: pd.DataFrame) -> None:
    changed = [
        frame.assign(t=frame["t"] + 1.0),
        frame.rename(columns={"force.2": "force.1"}),
        frame.rename(columns={"force.2": "force.2 (kN)"}),
        frame.iloc[:-1],
    ]
    names = {str(table_of(one).path) for one in (frame, frame.copy(), *changed)}
    assert len(names) == 1 + len(changed)


@pytest.mark.parametrize(
    ("data", "overrides", "told"),
    [
        (3, (), r"data=<int>: must be a pandas DataFrame"),
        ([], (), "a list of frames"),
        ({"t": [0, 1], "force.1": [1]}, (), "arrays of one length"),
        ({"a1": [0, 1]}, (), r"data='a1': must be columns such as force.1"),
        ({"force.1": [0], "force_1": [0]}, (), r"the only column of data.force.1"),
        ({"a": np.zeros((2, 2, 2))}, (), r"an array of shape \(2, 2, 2\)"),
        (pd.DataFrame([[1, 2]], columns=["a", "a"]), (), "different names"),
        ({"force.1": [0]}, ("data=csv",), "the record is in memory"),
        ({"t": [0.0, 0.1], "acceleration.2": [0.0, 1.0]}, CHAIN, "must be a window of at least 16 samples"),
        ({"acceleration.1": np.arange(20.0)}, CHAIN, r"data.time='t': must be a column of frame-\w+, which has"),
    ],
)
def test_data_that_no_run_can_use(data: object, overrides: tuple[str, ...], told: str) -> None:
    with pytest.raises(InputError, match=told):
        run(*overrides, data=data)
    assert not list(Path().iterdir())


RANDOM = np.random.default_rng(0).normal(size=64)


def channel(name: str, unit: str = "m/s²", **more: Any) -> dict[str, Any]:
    return {"name": name, "data": RANDOM, "unit_str": unit, "fs": 100.0, **more}


def test_a_record_in_si_units() -> None:
    series = [channel("acc 2", "g", quantity="a"), channel("load 3", "kN"), channel("laser 1", "mm", quantity="d")]
    record = Record.from_sep005(series)
    np.testing.assert_allclose(record.acceleration[:, 1], 9.80665 * RANDOM)
    np.testing.assert_allclose(record.force[:, 2], 1e3 * RANDOM)
    np.testing.assert_allclose(record.displacement[:, 0], 1e-3 * RANDOM)
    assert record.unforced.tolist() == [True, True, False]
    assert record.sampling_rate == pytest.approx(100.0, rel=1e-12)
    np.testing.assert_array_equal(record.observed, [True, True, False])
    there = Record.from_sep005([*series, channel("temperature", "degC")], {"acc 2": 1})
    assert there.to_frame().columns.tolist() == ["t", "acceleration.1"]


def test_channels_of_several_rates_stand_on_one_clock() -> None:
    start = "2026-03-01T12:00:00"
    slow = channel("slow 2", data=RANDOM[:20], fs=50.0, start_timestamp="2026-03-01T12:00:00.100")
    rows = {**channel("rows"), "data": [RANDOM, [None, *RANDOM[1:]]], "start_timestamp": start}
    table = table_of_sep005([slow, rows], "data")
    np.testing.assert_allclose(table.columns["t"], np.arange(64) / 100.0, atol=1e-6)
    np.testing.assert_array_equal(table.columns["slow 2"][10:50:2], RANDOM[:20])
    assert np.isnan(table.columns["slow 2"][11])
    np.testing.assert_array_equal(table.columns["rows.2"], [np.nan, *RANDOM[1:]])


def test_data_of_a_run() -> None:
    series = [channel("acc 2", quantity="a"), channel("force 1", "N")]
    assert is_sep005(series)
    assert is_sep005(series[0])
    assert not is_sep005([{"force.1": RANDOM}])
    assert not is_sep005([])
    with settings_of(series, ()) as found:
        assert found[2:] == ["data.time='t'", "data.force={1: 'force 1'}", "data.acceleration={2: 'acc 2'}"]
    with settings_of([series, series[:1]], ()) as found:
        assert found[1].count("path:") == 2
    # All that are there, or none: a force that is left out would be taken for none.
    with (
        pytest.raises(InputError, match=r"'hammer': must be columns such as force.1"),
        settings_of([series[0], channel("hammer", "N")], ()),
    ):
        pass


@pytest.mark.parametrize(
    ("series", "told"),
    [
        ([channel("a 1", unit="kg", quantity="a")], r"series\['a 1'\], unit_str=kg: must be a unit such as m/s\^2"),
        ([{**channel("a 1"), "unit_str": None}], r"series\['a 1'\], unit_str=None: must be given"),
        ([channel("a 1", fs=None)], "fs=None: must be given, in Hz, or time"),
        ([channel("a 1", fs=0)], r"series\['a 1'\], fs=0: must be a finite number > 0"),
        ([channel("a 1", time=RANDOM)], "time=an array of shape .*: must be 64 times that grow"),
        ([channel("a 1", start_timestamp="noon")], "start_timestamp=noon: must be a date as ISO 8601"),
        ([channel("a 1", data=["x"])], "data=list: must be an array of numbers"),
        ([channel("a 1"), channel("a 1")], "channels with different names"),
        ([channel("a 1"), channel("b 1")], "the only column of data.acceleration.1"),
        ([channel("acceleration.0")], "a channel of a DOF by its number, from 1"),
        ([channel("a 1", data=[*RANDOM[:-1], np.nan])], "empty or NaN: must be a finite number"),
    ],
)
def test_what_is_no_record(series: list[dict[str, Any]], told: str) -> None:
    with pytest.raises(InputError, match=told):
        Record.from_sep005(series)


def test_a_response_goes_out_and_is_read_again() -> None:
    time = 2.0 + np.arange(64) / 100.0
    variables = {
        name: (("time", "dof"), np.outer(RANDOM, [1.0, 2.0]), {"units": UNITS[quantity]})
        for quantity in ("displacement", "velocity", "acceleration", "force")
        for name in (quantity, f"{quantity}_std")
    }
    series = response_as_sep005(xr.Dataset(variables, {"time": time, "dof": [1, 2]}))
    assert len(series) == 16
    assert {(one["quantity"], one["unit_str"]) for one in series} == {
        ("d", "m"),
        ("v", "m/s"),
        ("a", "m/s²"),
        ("f", "N"),
    }
    # What the package sdypy-sep005 asks for.
    for one in series:
        assert isinstance(one["name"], str)
        assert one["data"].shape == (64,)
        assert isinstance(one["time"], list)
        assert one["fs"] == pytest.approx(100.0)
    again = Record.from_sep005([one for one in series if one["group"] == "estimate"])
    np.testing.assert_array_equal(again.velocity[:, 1], 2.0 * RANDOM)
    np.testing.assert_allclose(again.time, time)
