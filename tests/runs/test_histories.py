"""Labelled arrays come in as they were written, or as one line: another process reads them."""

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr
from fuzz.changes import HISTORIES, hdf5_

from pinn_cli.report.netcdf import write_dataset
from pinn_cli.runs import apart, histories
from pinn_cli.runs.histories import read_groups, read_histories, read_tree
from pinn_cli.runs.reading import DamagedError
from pinn_cli.settings.errors import InputError

# Kinds of damage that this process may not survive.
TOO_MUCH = ("one text", "random")
DEEDS = """
import ctypes, os, time

def crash(files, names):
    yield {"/": [{}, {}]}, []
    ctypes.string_at(0)

def loop(files, names):
    yield {"/": [{}, {}]}, []
    while True:
        time.sleep(0.01)
"""


def dataset() -> xr.Dataset:
    """With everything that a run writes."""
    time, gaps = 0.1 * np.arange(20), np.where(np.arange(40).reshape(20, 2) % 3 == 0, np.nan, 1.5)
    motion = {name: (("time", "dof"), gaps, {"units": "m"}) for name in ("displacement", "velocity", "force")}
    coordinates = {
        "time": ("time", time, {"units": "s"}), "dof": ("dof", np.array([1, 2], dtype=np.int32)),
        "observed": ("dof", np.array([True, False])), "dof_name": ("dof", np.array(["top", "ä"], dtype=object)),
        "connection": ("connection", np.array([], dtype=str)),
    }  # fmt: skip
    attributes = {"case": "small", "ndof": 2, "snr_db": 50.0, "levels": [1.0, 2.0], "words": ["a", "b"]}
    return xr.Dataset(motion, coordinates, attributes)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    dataset().to_netcdf(tmp_path / "x.nc", engine="h5netcdf")
    return tmp_path / "x.nc"


@pytest.mark.apart
def test_histories_are_what_xarray_reads(file: Path) -> None:
    expected, found = xr.load_dataset(file, engine="h5netcdf"), read_histories(file)
    xr.testing.assert_identical(found, expected)
    assert list(found.variables) == list(expected.variables)
    assert {n: v.dtype for n, v in found.variables.items()} == {n: v.dtype for n, v in expected.variables.items()}
    for name, value in expected.attrs.items():
        assert type(found.attrs[name]) is type(value)


def test_what_a_run_writes_has_its_layout_s_number_and_a_later_one_is_refused(tmp_path: Path) -> None:
    file = write_dataset(dataset(), tmp_path / "x.nc")
    assert read_histories(file).attrs["format"] == histories.HISTORIES
    with h5py.File(file, "a") as opened:
        opened.attrs.update(format=99, written_by="pinn-cli 9.9.9")
    for group in (["/"], None):
        with pytest.raises(InputError, match=r"x\.nc=format 99: must be of format 1; pinn-cli 9\.9\.9 wrote it"):
            list(read_groups([file], group))


def test_a_tree_is_what_xarray_reads(tmp_path: Path) -> None:
    file, groups = tmp_path / "posterior.nc", {"/": xr.Dataset(attrs={"method": "x"}), "posterior": dataset()}
    xr.DataTree.from_dict(groups).to_netcdf(file, engine="h5netcdf")
    xr.testing.assert_identical(read_tree(file), xr.load_datatree(file, engine="h5netcdf"))
    xr.testing.assert_identical(read_histories(file, "posterior"), read_tree(file)["posterior"].to_dataset())


def test_histories_are_no_more_than_the_file_and_groups_have_an_end(tmp_path: Path) -> None:
    file, zeros = tmp_path / "x.nc", xr.Dataset({"u": ("time", np.zeros(10**6))})
    zeros.to_netcdf(file, engine="h5netcdf")
    assert read_histories(file).sizes["time"] == 10**6
    zeros.to_netcdf(file, engine="h5netcdf", encoding={"u": {"zlib": True, "complevel": 9}})
    with pytest.raises(DamagedError, match="unfolds to more than was written"):
        read_histories(file)
    with h5py.File(tmp_path / "x.nc", "w") as file:
        for number in range(101):
            file[f"g{number}"] = file["/"]
    with pytest.raises(DamagedError, match="more than 100 groups"):
        read_tree(tmp_path / "x.nc")


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("elsewhere", "it links to another place"),
        ("links", "it links to another place"),
        ("virtual", "it holds data of another file"),
        ("raw", "it holds data of another file"),
        ("huge", "it unfolds to more than was written"),
        ("packed", "it unfolds to more than was written"),
        pytest.param("compound", "neither numbers nor texts", marks=pytest.mark.apart),
        ("references", "other things than numbers and texts"),
    ],
)
def test_what_is_none_of_ours_is_refused(file: Path, kind: str, reason: str) -> None:
    hdf5_(file, kind)
    with pytest.raises(DamagedError, match=f"^x.nc cannot be read: .*{reason}"):
        read_histories(file)


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.apart if kind in TOO_MUCH else ()) for kind in sorted(HISTORIES)]
)
def test_any_damage_is_read_or_told_in_one_line(file: Path, kind: str) -> None:
    before = file.read_bytes()
    hdf5_(file, kind)
    assert file.read_bytes() != before
    for read in (read_histories, read_tree):
        try:
            text = repr(read(file))
        except DamagedError as error:
            text = str(error)
            assert "\n" not in text
        assert "\x1b" not in text


@pytest.mark.apart
@pytest.mark.parametrize(("deed", "reason"), [("crash", "its reader crashes"), ("loop", "takes more than 2 s to read")])
def test_what_a_file_does_to_its_library_is_told(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, deed: str, reason: str
) -> None:
    """Of several files, that one is named; those before it are read."""
    (tmp_path / "odd_deeds.py").write_text(DEEDS, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    odd: Callable[..., Any] = getattr(importlib.import_module("odd_deeds"), deed)
    monkeypatch.setattr(histories, "stored", odd)
    monkeypatch.setattr(apart, "_SECONDS", 2.0)
    monkeypatch.setattr(apart, "_BUSY", 1)
    groups = read_groups([file, tmp_path / "y.nc"])
    assert next(groups)["/"].arrays == {}
    with pytest.raises(DamagedError, match=f"^y.nc cannot be read: .*{reason}$"):
        next(groups)
