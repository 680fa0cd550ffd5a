"""Time series as SDyPy's SEP 5 has them, in and out."""

from typing import Any

import numpy as np
import pytest
import xarray as xr

from pinn_cli import InputError, Record
from pinn_cli.api.data import settings_of
from pinn_cli.api.sep005 import is_sep005, response_as_sep005, table_of_sep005
from pinn_cli.system.quantities import UNITS

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
