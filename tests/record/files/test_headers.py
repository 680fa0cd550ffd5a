"""What headers tell: units, places, times, scales; and channels of different rates on one clock."""

import pickle
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr
from calls import refusal

from pinn_cli.record.files.csv import CsvFormat
from pinn_cli.record.files.hdf5 import Hdf5Format
from pinn_cli.record.files.netcdf import NetcdfFormat
from pinn_cli.record.files.parquet import ParquetFormat
from pinn_cli.record.files.table import SensorHint
from pinn_cli.record.files.tdms import TdmsFormat
from pinn_cli.record.files.uff import UffFormat

VALUES = np.sin(np.arange(40.0))


def data_set(**changes) -> dict:
    """A time history of pyuff's: acceleration of node 1 along Z, 40 samples at 100 Hz."""
    pyuff = pytest.importorskip("pyuff")
    settings = {
        "binary": 0, "func_type": 1, "rsp_node": 1, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0, "data": VALUES,
        "x": np.arange(len(VALUES)) / 100.0, "abscissa_spacing": 1, "abscissa_spec_data_type": 17,
        "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 0, "z_axis_spec_data_type": 0, "id1": "NONE",
    }  # fmt: skip
    return pyuff.prepare_58(**settings | changes)


def universal(path: Path, *sets: dict) -> Path:
    pytest.importorskip("pyuff").UFF(str(path)).write_sets(list(sets))
    return path


def test_a_universal_file_tells_quantity_place_and_unit(tmp_path):
    path = universal(
        tmp_path / "rig.uff",
        data_set(ordinate_axis_units_lab="g"),
        data_set(rsp_dir=-1, ordinate_spec_data_type=8, id1="roof"),
        data_set(rsp_node=12, ordinate_spec_data_type=13),
        data_set(),
        data_set(rsp_node=0, rsp_dir=0, ordinate_spec_data_type=0),
    )
    table = UffFormat().read(path)
    assert table.hints == {
        "acceleration 1:+Z": SensorHint("g", "acceleration", "1:+Z"),
        "displacement 1:-X": SensorHint("", "displacement", "1:-X"),
        "force 12:+Z": SensorHint("", "force", "12:+Z"),
        "acceleration 1:+Z (2)": SensorHint("", "acceleration", "1:+Z"),
    }
    assert list(table.columns)[-1] == "channel"
    np.testing.assert_allclose(table.time, np.arange(40) / 100.0)
    by_label = UffFormat().read(path, {"data.displacement.1": "roof"})
    np.testing.assert_allclose(by_label.columns["roof"], VALUES, atol=1e-11)
    units = pytest.importorskip("pyuff").prepare_164(
        units_code=5, units_description="mm", temp_mode=1, length=1e3, force=1e3, temp=1.0, temp_offset=273.15
    )
    table = UffFormat().read(universal(tmp_path / "mm.uff", units, data_set(), data_set(ordinate_spec_data_type=13)))
    assert [hint.unit for hint in table.hints.values()] == ["mm/s^2", "mN"]


def test_data_sets_of_different_rates_stand_on_one_clock(tmp_path):
    slow = data_set(rsp_node=2, data=VALUES[::4].copy(), x=np.arange(10) / 25.0)
    table = UffFormat().read(universal(tmp_path / "rig.uff", data_set(), slow))
    np.testing.assert_allclose(table.time, np.arange(40) / 100.0)
    np.testing.assert_allclose(table.columns["acceleration 2:+Z"][::4], VALUES[::4], atol=1e-11)
    assert np.isnan(table.columns["acceleration 2:+Z"]).sum() == 30
    assert table.place("acceleration 2:+Z", 4) == "rig.uff, column 'acceleration 2:+Z', sample 2"
    assert table.place("acceleration 2:+Z", 5) == "rig.uff, column 'acceleration 2:+Z', at 0.05 s"


@pytest.mark.parametrize(
    ("sets", "expected"),
    [
        ([], "it has none, and no time history"),
        ([{"func_type": 4, "data": VALUES + 1j, "abscissa_spec_data_type": 18}], "it has 1 frequency response"),
        ([{"x": np.zeros(40)}], "must be a file whose times increase; those of 'acceleration 1:+Z'"),
        ([{"x": np.zeros(40), "abscissa_spacing": 0}], "must be a file whose times increase; those of 'acceleration"),
        ([{"num_pts": 80}], "'acceleration 1:+Z' has 40 of the 80 samples that its header tells"),
    ],
)  # fmt: skip
def test_a_universal_file_without_a_record(tmp_path, sets, expected):
    path = tmp_path / "rig.uff"
    if sets:
        longer = [changes.pop("num_pts", 40) for changes in sets]
        universal(path, *(data_set(**changes) for changes in sets))
        path.write_text(path.read_text().replace("        40         1", f"{longer[0]:10}         1"))
    else:
        path.write_text("    -1\n   151\nmodel\n    -1\n")
    assert expected in refusal(UffFormat().read, path)


def test_channels_of_a_tdms_file(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    fast = {"wf_increment": 0.01, "wf_start_offset": 2.0, "unit_string": "g"}
    slow = {"wf_increment": 0.04, "wf_start_offset": 2.0}
    with nptdms.TdmsWriter(tmp_path / "rig.tdms") as file:
        file.write_segment([
            nptdms.ChannelObject("rig", "a", VALUES, fast),
            nptdms.ChannelObject("rig", "b", VALUES[::4], slow),
            nptdms.ChannelObject("other", "a", VALUES.astype(np.int16)),
            nptdms.ChannelObject("other", "note", ["x", "y"]),
        ])  # fmt: skip
    wanted = {"data.force.1": "rig/a", "data.acceleration.1": "b"}
    table = TdmsFormat().read(tmp_path / "rig.tdms", wanted)
    np.testing.assert_allclose(table.time, 2.0 + np.arange(40) / 100.0)
    np.testing.assert_array_equal(table.columns["b"][::4], VALUES[::4])
    assert table.hints == {"rig/a": SensorHint("g")}
    read = TdmsFormat().read
    assert "must be a column of rig.tdms" in refusal(read, tmp_path / "rig.tdms", {"data.force.1": "a"})
    assert "holds text or objects" in refusal(read, tmp_path / "rig.tdms", {"data.force.1": "note"})
    both = {"data.force.1": "other/a", "data.acceleration.1": "b"}
    assert "10 samples of 'b', 40 of 'other/a'" in refusal(read, tmp_path / "rig.tdms", both)


def test_netcdf_is_unpacked_and_its_missing_values_are_empty_cells(tmp_path):
    values = np.round(VALUES, 2)
    values[3] = np.nan
    packing = {"scale_factor": 0.01, "add_offset": 5.0, "dtype": "int16", "_FillValue": -9999}
    xr.Dataset({"a": ("time", values, {"units": "m/s^2"})}).to_netcdf(tmp_path / "rig.nc", encoding={"a": packing})
    table = NetcdfFormat().read(tmp_path / "rig.nc")
    np.testing.assert_allclose(table.columns["a"], values, atol=1e-12)
    assert table.hints == {"a": SensorHint("m/s^2")}
    with h5py.File(tmp_path / "plain.h5", "w") as file:
        file["a"] = np.arange(5)
        file["a"].attrs["scale_factor"] = 2.0
    np.testing.assert_array_equal(Hdf5Format().read(tmp_path / "plain.h5").columns["a"], np.arange(5.0))


def test_hdf5_reads_what_the_file_itself_holds_and_unpickles_nothing(tmp_path):
    (tmp_path / "secret.bin").write_bytes(VALUES.tobytes())
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["a"] = VALUES
    with h5py.File(tmp_path / "rig.h5", "w") as file:
        file["link"] = h5py.ExternalLink("other.h5", "/a")
        file.create_dataset("raw", (40,), "f8", external=[(str(tmp_path / "secret.bin"), 0, h5py.h5f.UNLIMITED)])
        layout = h5py.VirtualLayout((40,), "f8")
        layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "a", (40,))
        file.create_virtual_dataset("virtual", layout)
        file["pickled"] = np.void(pickle.dumps(VALUES))
        file["words"] = ["=1+1"] * 40
        file["table"] = np.array([(1.5, 2), (2.5, 3)], dtype=[("a", "f8"), ("n", "i4")])
    read = Hdf5Format().read
    for name, expected in {
        "link": "must be a column of rig.h5",
        "raw": "holds data of another file",
        "virtual": "holds data of another file",
        "pickled": "holds text or objects",
        "words": "holds text or objects",
    }.items():
        assert expected in refusal(read, tmp_path / "rig.h5", {"data.force.1": name})
    assert read(tmp_path / "rig.h5", {"data.force.1": "table.a"}).columns["table.a"].tolist() == [1.5, 2.5]


def test_parquet_refuses_what_is_no_number(tmp_path):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    fields = [
        pa.field("a", pa.float32(), metadata={"unit": "g"}),
        pa.field("n", pa.int64()),
        pa.field("x", pa.string()),
    ]
    columns = [[0.5, None, 1.5], [1, 2, None], ["=1+1", "2", "3"]]
    time = pa.array([0, 1, 2], pa.timestamp("ms"))
    table = pa.table([*columns, time, [True, False, True]], [*(f.name for f in fields), "t", "on"])
    table = table.cast(pa.schema([*fields, pa.field("t", time.type), pa.field("on", pa.bool_())]))
    pq.write_table(table, tmp_path / "rig.parquet")
    read = ParquetFormat().read(tmp_path / "rig.parquet")
    assert list(read.columns) == ["a", "n"]
    np.testing.assert_array_equal(read.columns["a"], [0.5, np.nan, 1.5])
    np.testing.assert_array_equal(read.columns["n"], [1.0, 2.0, np.nan])
    assert read.hints == {"a": SensorHint("g")}
    for name, holds in (("x", "string"), ("t", "timestamp[ms]"), ("on", "bool")):
        told = refusal(ParquetFormat().read, tmp_path / "rig.parquet", {"data.time": name})
        assert told.startswith(f"data.time='{name}': must be a column of numbers")
        assert f"in rig.parquet {name!r} holds {holds}" in told


@pytest.mark.parametrize(
    ("text", "settings", "columns", "hints", "first_line"),
    [
        ("t;a [g]\n0,0;1,5\n0,1;-2\n", {}, {"t": [0, 0.1], "a [g]": [1.5, -2]}, {"a [g]": "g"}, 2),
        ("t,a\ns,m/s^2\n0,1\n1,2\n", {}, {"t": [0, 1], "a": [1, 2]}, {"t": "s", "a": "m/s^2"}, 3),
        ("t\ta\n[s]\t[kN]\n0\t1,5\n", {}, {"t": [0], "a": [1.5]}, {"t": "s", "a": "kN"}, 3),
        ("t a\n0  1.5\n1\t2e-3\n", {}, {"t": [0, 1], "a": [1.5, 2e-3]}, {}, 2),
        ("my rig\n2026\nt,a\n0,1\n", {"names_line": 3}, {"t": [0], "a": [1]}, {}, 4),
        ("t|a\n0|1\n", {}, {"t": [0], "a": [1]}, {}, 2),
        ("t:a\n0:1\n", {"separator": ":"}, {"t": [0], "a": [1]}, {}, 2),
        ("t\ta\n0\t1\n", {"separator": "\\t"}, {"t": [0], "a": [1]}, {}, 2),
        ("t;a\n0;1,000\n", {"decimal": ","}, {"t": [0], "a": [1]}, {}, 2),
        ("t;a\n1.5.2026;1,5\n2.5.2026;-2\n", {}, {"t": [np.nan, np.nan], "a": [1.5, -2]}, {}, 2),
        ("t;a\n0;1\n1;\n", {}, {"t": [0, 1], "a": [1, np.nan]}, {}, 2),
        (
            "t,a (roof),b (m/s\xb2),c [kN],d (um)\n0,1,2,3,4\n",
            {},
            {"t": [0], "a (roof)": [1], "b (m/s\xb2)": [2], "c [kN]": [3], "d (um)": [4]},
            {"b (m/s\xb2)": "m/s^2", "c [kN]": "kN", "d (um)": "um"},
            2,
        ),
        ("t,a\xb2\n0,1\n", {"encoding": "latin-1"}, {"t": [0], "a\xb2": [1]}, {}, 2),
        ("t,a\xb2\n0,1\n", {}, {"t": [0], "a\xb2": [1]}, {}, 2),
    ],
)
def test_how_text_is_written_is_recognised_or_set(tmp_path, text, settings, columns, hints, first_line):
    (tmp_path / "rig.csv").write_bytes(text.encode("latin-1"))
    table = CsvFormat(**settings).read(tmp_path / "rig.csv")
    assert list(table.columns) == list(columns)
    for name, values in columns.items():
        np.testing.assert_array_equal(table.columns[name], values)
    assert {name: hint.unit for name, hint in table.hints.items()} == hints
    assert table.first_line == first_line


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("t;a\n0;1,5\n1;2.5\n", "column 'a', line 2='1,5': must be a finite number; decimals take a point"),
        ("t;a\n0;1,5\n1;x\n", "column 'a', line 3='x': must be a finite number"),
        ("t,a\ns,g\n0,=1+1\n", "column 'a', line 3='=1+1': must be a finite number"),
        ("t,a\n" + "0,1\n1,2\n" * 20 + "2,# the door\n", "column 'a', line 42='# the door': must be a finite number"),
    ],
)
def test_cells_that_are_no_numbers_keep_their_line(tmp_path, text, expected):
    (tmp_path / "rig.csv").write_text(text)
    assert expected in refusal(CsvFormat().read(tmp_path / "rig.csv").numbers, "a")


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"separator": "ab"}, "separator='ab'"), ({"separator": ""}, "separator=''"), ({"decimal": "x"}, "decimal='x'"),
        ({"separator": ",", "decimal": ","}, "decimal=','"), ({"encoding": "klingon"}, "encoding=klingon"),
        ({"encoding": 8}, "encoding=8"), ({"names_line": 0}, "names_line=0"),
        ({"names_line": 9}, "names_line=9: must be a line of rig.csv, which has 2"),
    ],
)  # fmt: skip
def test_settings_of_text_that_cannot_be_used(tmp_path, settings, told):
    (tmp_path / "rig.csv").write_text("t,a\n0,1\n")
    assert refusal(lambda: CsvFormat(**settings).read(tmp_path / "rig.csv")).startswith(f"data.format.{told}")
