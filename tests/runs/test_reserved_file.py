"""Files whose place on the disk is taken before they are written."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from pinn_cli.runs.reserved_file import replacing_by_reserved
from pinn_cli.runs.writing import WriteError

HISTORIES = xr.Dataset({"u": (("time", "dof"), np.arange(6.0).reshape(3, 2), {"units": "m"})})


def test_the_bytes_are_those_of_a_file_in_memory(tmp_path: Path) -> None:
    with replacing_by_reserved(tmp_path / "u.nc", 2**20) as file:
        HISTORIES.to_netcdf(file, engine="h5netcdf", format="NETCDF4")
    expected = bytes(HISTORIES.to_netcdf(None, engine="h5netcdf", format="NETCDF4"))
    assert (tmp_path / "u.nc").read_bytes() == expected
    assert [place.name for place in tmp_path.iterdir()] == ["u.nc"]


def test_a_system_that_reserves_nothing_writes_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "posix_fallocate", raising=False)
    with replacing_by_reserved(tmp_path / "text", 100) as file:
        file.write(b"abc")
    assert (tmp_path / "text").read_bytes() == b"abc"


def test_a_full_disk_is_told_before_anything_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "text").write_bytes(b"old")

    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    with (
        pytest.raises(WriteError, match="No space left"),
        replacing_by_reserved(tmp_path / "text", 100),
    ):
        pytest.fail("the block was entered")
    assert [place.read_bytes() for place in tmp_path.iterdir()] == [b"old"]


def test_reading_ends_where_writing_did(tmp_path: Path) -> None:
    with replacing_by_reserved(tmp_path / "text", 100) as file:
        file.write(b"abcdef")
        file.seek(-2, os.SEEK_END)
        assert file.read(10) == b"ef"
        file.truncate(4)
        assert file.seek(0, os.SEEK_END) == 4
    assert (tmp_path / "text").read_bytes() == b"abcd"
