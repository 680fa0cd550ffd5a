"""The same record in every format gives the same numbers; and what a file that cannot be used says."""

import gzip
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calls import refusal
from omegaconf import OmegaConf
from scipy.io import netcdf_file, savemat

from pinn_cli.cli.records import data_of_records
from pinn_cli.record.clock import FORMATS, format_of
from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.settings.instantiation import build

CONF = Path(__file__).parents[3] / "conf" / "data"
ROWS, RATE = 64, 128.0  # a step that text has exactly
TIME = np.arange(ROWS) / RATE
NUMBERS = {
    "t": TIME,
    "f": np.round(np.sin(9.0 * TIME), 9),
    "a1": np.round(np.cos(7.0 * TIME), 9),
    "a2": np.round(TIME**2 - 3.0, 9),
}
TABLE = pd.DataFrame(NUMBERS)
PAIR = TABLE[["a1", "a2"]].to_numpy()


def write_text(path: Path, encoding: str = "utf-8", **options) -> None:
    path.write_bytes(TABLE.to_csv(index=False, **options).encode(encoding))


def write_gzip(path: Path) -> None:
    path.write_bytes(gzip.compress(TABLE.to_csv(index=False).encode()))


def write_netcdf(path: Path, group: str | None = None) -> None:
    xr.Dataset({name: ("time", values) for name, values in NUMBERS.items()}).to_netcdf(path, group=group)


def write_hdf5(path: Path, prefix: str = "rig/") -> None:
    with h5py.File(path, "w") as file:
        for name, values in NUMBERS.items():
            file[f"{prefix}{name}"] = values


def write_mat73(path: Path) -> None:
    """As MATLAB does: 512 bytes in front, vectors as columns, the axes of arrays in Fortran's order."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in NUMBERS.items():
            file[name] = values[None, :]
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def write_netcdf3(path: Path) -> None:
    with netcdf_file(path, "w") as file:
        file.createDimension("time", ROWS)
        for name, values in NUMBERS.items():
            file.createVariable(name, "f8", ("time",))[:] = values


def write_parquet(path: Path) -> None:
    pytest.importorskip("pyarrow")
    TABLE.to_parquet(path)


def write_tdms(path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    times = {"wf_increment": 1.0 / RATE, "wf_start_offset": 0.0}
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.ChannelObject("rig", n, v, times) for n, v in NUMBERS.items() if n != "t"])


def write_uff(path: Path, binary: int = 0) -> None:
    pyuff = pytest.importorskip("pyuff")
    kinds = {"f": (13, 1), "a1": (12, 1), "a2": (12, 2)}
    sets = [
        pyuff.prepare_58(
            binary=binary, func_type=1, rsp_node=kinds[name][1], rsp_dir=3, ref_node=0, ref_dir=0, id1=name,
            data=NUMBERS[name], x=TIME, abscissa_spacing=1, abscissa_spec_data_type=17,
            ordinate_spec_data_type=kinds[name][0], orddenom_spec_data_type=0, z_axis_spec_data_type=0,
            ordinate_axis_units_lab="N" if name == "f" else "m/s^2",
        )
        for name in kinds
    ]  # fmt: skip
    path.unlink(missing_ok=True)  # pyuff overwrites no binary file
    pyuff.UFF(str(path)).write_sets(sets)


def columns(time: str | None = "t", f: str = "f", a1: str = "a1", a2: str = "a2") -> dict:
    return {"time": time, "force": {1: f}, "acceleration": {1: a1, 2: a2}}


IN_RIG = columns("rig/t", "rig/f", "rig/a1", "rig/a2")
# File, choice of data=..., how it is written, and what its columns are called.
CASES = {
    "comma": ("rig.csv", "csv", write_text, columns()),
    "semicolon": ("rig.csv", "csv", lambda p: write_text(p, sep=";"), columns()),
    "decimal comma": ("rig.csv", "csv", lambda p: write_text(p, sep=";", decimal=","), columns()),
    "tabs, decimal comma": ("rig.tsv", "csv", lambda p: write_text(p, sep="\t", decimal=","), columns()),
    "blanks": ("rig.txt", "csv", lambda p: write_text(p, sep=" "), columns()),
    "utf-16": ("rig.csv", "csv", lambda p: write_text(p, "utf-16"), columns()),
    "gzip": ("rig.csv.gz", "csv", write_gzip, columns()),
    "mat 5": ("rig.mat", "mat", lambda p: savemat(p, NUMBERS), columns()),
    "mat 4": ("rig.mat", "mat", lambda p: savemat(p, NUMBERS, format="4"), columns()),
    "mat 5, packed": ("rig.mat", "mat", lambda p: savemat(p, NUMBERS, do_compression=True), columns()),
    "mat, structure": (
        "rig.mat", "mat", lambda p: savemat(p, {"rig": {"day": {"acc": PAIR}, "t": TIME, "f": NUMBERS["f"]}}),
        columns("rig.t", "rig.f", "rig.day.acc.1", "rig.day.acc.2"),
    ),
    "mat, channels in rows": (
        "rig.mat", "mat", lambda p: savemat(p, {"x": TABLE.to_numpy().T}), columns("x.1", "x.2", "x.3", "x.4"),
    ),
    "mat 7.3": ("rig.mat", "mat", write_mat73, columns()),
    "uff": ("rig.uff", "uff", write_uff, columns(None, "force 1:+Z", "acceleration 1:+Z", "acceleration 2:+Z")),
    "uff, binary": ("rig.uff", "uff", lambda p: write_uff(p, 1), columns(None)),
    "parquet": ("rig.parquet", "parquet", write_parquet, columns()),
    "tdms": ("rig.tdms", "tdms", write_tdms, columns(None, "rig/f", "a1", "a2")),
    "hdf5": ("rig.h5", "hdf5", write_hdf5, IN_RIG),
    "hdf5 by full path": ("rig.h5", "hdf5", write_hdf5, columns("/rig/t", "/rig/f", "/rig/a1", "rig/a2")),
    "netcdf": ("rig.nc", "netcdf", write_netcdf, columns()),
    "netcdf, group": (
        "rig.nc", "netcdf", lambda p: write_netcdf(p, group="rig"), IN_RIG,
    ),
    "netcdf 3": ("rig.nc", "netcdf", write_netcdf3, columns()),
}  # fmt: skip


def data(folder: Path, name: str, choice: str, settings: dict) -> MeasuredData:
    """By the settings of ``conf/data``."""
    option = {key: value for key, value in OmegaConf.load(CONF / f"{choice}.yaml").items() if key != "defaults"}
    node = OmegaConf.merge(OmegaConf.load(CONF / "_measured.yaml"), option, {"path": name, **settings})
    (own,) = data_of_records(node)
    return build(own, "data", base=folder)


def message(folder: Path, name: str, choice: str, settings: dict | None = None) -> str:
    return refusal(lambda: data(folder, name, choice, settings or columns()).measure(2))


@pytest.mark.parametrize("case", CASES)
def test_the_same_record_gives_the_same_numbers(tmp_path, case):
    """Its format is chosen, or told by its suffix; all columns are read where none is asked for."""
    name, choice, write, settings = CASES[case]
    write(tmp_path / name)
    # pyuff writes the step with six digits and the numbers with twelve.
    digit = 1e-15 if choice != "uff" else 1e-11
    for chosen in {choice, "csv"}:
        record = data(tmp_path, name, chosen, settings).measure(2).record
        np.testing.assert_allclose(record.time, TIME, rtol=0, atol=1e-12)
        np.testing.assert_allclose(record.force[:, 0], NUMBERS["f"], rtol=0, atol=digit)
        np.testing.assert_allclose(record.acceleration, PAIR, rtol=0, atol=digit)
    table = format_of(tmp_path / name, FORMATS[0]()).read(tmp_path / name)
    assert (len(table), len(table.columns)) == (ROWS, 3 if settings["time"] is None else 4)
    told = message(tmp_path, name, choice, {**settings, "acceleration": {1: "roof"}})
    assert told.startswith(f"data.acceleration.1='roof': must be a column of {name}, which has '")


@pytest.mark.parametrize("case", [case for case in CASES if CASES[case][1] != "csv"] + ["gzip"])
@pytest.mark.parametrize("part", [0.0, 0.4, *(pytest.param(part, marks=pytest.mark.slow) for part in (0.02, 0.97))])
def test_a_file_that_is_cut_off(tmp_path, case, part):
    name, choice, write, settings = CASES[case]
    path = tmp_path / name
    write(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(part * len(content))])
    if case in ("mat 4", "mat 5") and part:  # whole variables may be left, which are then too few
        assert any(words in message(tmp_path, name, choice, settings) for words in ("whole", "a column of"))
    elif case == "netcdf 3" and part == 0.97:
        assert "whole" in message(tmp_path, name, choice, settings)
    else:
        told = message(tmp_path, name, choice, settings)
        assert told.startswith(f"data.path={path}: must be ")
        assert part or "it is empty" in told or "comma-separated" in told


@pytest.mark.parametrize("choice", ["mat", "parquet", "tdms", "hdf5", "netcdf", "uff"])
def test_a_file_in_another_format_than_its_suffix_says(tmp_path, choice):
    suffix = {"mat": ".mat", "parquet": ".pq", "tdms": ".tdms", "hdf5": ".h5", "netcdf": ".nc", "uff": ".uff"}[choice]
    write_text(tmp_path / f"rig{suffix}")
    assert message(tmp_path, f"rig{suffix}", choice).endswith("; it is text (data=csv?)")
    (tmp_path / f"rig{suffix}").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(600))
    assert message(tmp_path, f"rig{suffix}", choice).endswith("; another format, or damaged?")
    assert "must be a file that exists" in message(tmp_path, f"nothing{suffix}", choice)


@pytest.mark.parametrize("choice", ["uff", "parquet", "tdms"])
def test_a_format_whose_package_is_missing(tmp_path, choice, monkeypatch):
    name, _, write, settings = CASES[choice]
    write(tmp_path / name)

    monkeypatch.setattr("pinn_cli.record.files.file_format.find_spec", lambda module: None)
    told = message(tmp_path, name, "csv", settings)
    assert told.startswith(f"data.format={choice}: must be a format whose package is installed; {choice} needs ")
    assert told.endswith(f"; pip install 'pinn-cli[{choice}]'")


def test_a_file_that_unpacks_to_more_than_memory_holds(tmp_path, monkeypatch):
    (tmp_path / "rig.csv.gz").write_bytes(gzip.compress(b"t,f,a1,a2\n" + b"0,0,0,0\n" * 200_000))
    with h5py.File(tmp_path / "rig.h5", "w") as file:
        for name in ("t", "f", "a1", "a2"):
            file.create_dataset(name, shape=(10**6,), dtype="f8", compression="gzip", chunks=(10**5,))
    monkeypatch.setattr("pinn_cli.record.files.file_format.of_this_machine", lambda: 2**20 * 16)
    assert "must be a file of at most 0.000977 GiB" in message(tmp_path, "rig.csv.gz", "csv")
    assert "must be a file of at most 0.000977 GiB" in message(tmp_path, "rig.h5", "hdf5")
