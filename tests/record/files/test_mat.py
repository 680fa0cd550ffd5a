"""MAT files that other programs wrote: MATLAB's own, kept with SciPy's tests, and hdf5storage's of version 7.3."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io.matlab
from calls import refusal
from scipy.io import savemat

from pinn_cli.record.files.mat import MatFormat
from pinn_cli.settings.errors import InputError

MATLABS = Path(scipy.io.matlab.__file__).parent / "tests" / "data"
NINE = np.linspace(0.0, 2.0 * np.pi, 9)


def of_matlab(name: str) -> Path:
    if not (MATLABS / name).exists():
        pytest.skip("SciPy is installed without its tests")
    return MATLABS / name


def message(path: Path, name: str) -> str:
    return refusal(MatFormat().read, path, {"data.acceleration.1": name})


@pytest.mark.parametrize("version", ["4.2c_SOL2", "6.1_SOL2", "6.5.1_GLNX86", "7.1_GLNX86", "7.4_GLNX86", "7.3"])
def test_vectors_of_every_version(version):
    file = of_matlab("testhdf5_7.4_GLNX86.mat" if version == "7.3" else f"testdouble_{version}.mat")
    table = MatFormat().read(file, {"data.time": "testdouble"})
    np.testing.assert_allclose(table.columns["testdouble"], np.arange(9) * np.pi / 4.0, rtol=1e-15)


@pytest.mark.parametrize(
    ("file", "name", "expected"),
    [
        ("testmatrix_7.4_GLNX86.mat", "testmatrix.2", [2.0, 0.0, 0.0, 0.0, 0.0]),
        ("teststructnest_7.4_GLNX86.mat", "teststructnest.one", None),
        ("big_endian.mat", "floats.1", [2.0, 3.0]),
        ("little_endian.mat", "floats.2", [3.0, 4.0]),
    ],
)
def test_parts_of_variables(file, name, expected):
    if expected is None:
        assert "in teststructnest_7.4_GLNX86.mat 'teststructnest.one' is 1 × 1" in message(of_matlab(file), name)
    else:
        assert MatFormat().read(of_matlab(file), {"data.time": name}).columns[name].tolist() == expected


@pytest.mark.parametrize(
    ("file", "name", "expected"),
    [
        ("testmatrix_7.4_GLNX86.mat", "testmatrix", "must be a column of numbers: a vector, or"),
        ("testmatrix_7.4_GLNX86.mat", "testmatrix.4", "'testmatrix' is "),
        ("test3dmatrix_7.4_GLNX86.mat", "test3dmatrix", "'test3dmatrix' is 2 × 3 × 4"),
        ("testcomplex_7.4_GLNX86.mat", "testcomplex", "holds complex numbers, which pinn-run does not evaluate"),
        ("testcell_7.4_GLNX86.mat", "testcell", "holds cells, which pinn-run does not evaluate"),
        ("teststring_7.4_GLNX86.mat", "teststring", "holds text, which"),
        ("testobject_7.4_GLNX86.mat", "testobject", "holds an object, which"),
        ("testfunc_7.4_GLNX86.mat", "testfunc", "holds a function, which"),
        ("testsparse_7.4_GLNX86.mat", "testsparse", "holds a sparse matrix, which"),
        ("testhdf5_7.4_GLNX86.mat", "testcell", "must be a column of testhdf5_7.4_GLNX86.mat, which has 'testdouble'"),
        ("teststructnest_7.4_GLNX86.mat", "teststructnest", "name one of its fields, such as tests"),
        ("malformed1.mat", "x", "must be a MAT file that is whole; damaged or cut off?"),
        ("corrupted_zlib_data.mat", "x", "must be a MAT file that is whole; damaged or cut off?"),
    ],
)
def test_what_is_no_vector_of_numbers_is_told(file, name, expected):
    assert expected in message(of_matlab(file), name)


def test_elements_of_an_array_of_structures(tmp_path):
    channels = np.array([(NINE, "m/s^2"), (2.0 * NINE, "g")], dtype=[("y", object), ("unit", object)])
    savemat(tmp_path / "rig.mat", {"channels": channels, "empty": np.empty((0, 0)), "two": [1.0, 2.0]})
    table = MatFormat().read(tmp_path / "rig.mat", {"data.force.1": "channels.2.y"})
    np.testing.assert_array_equal(table.columns["channels.2.y"], 2.0 * NINE)
    assert "holds text" in message(tmp_path / "rig.mat", "channels.1.unit")
    assert "is 0 × 0" in message(tmp_path / "rig.mat", "empty")


def test_columns_of_two_lengths(tmp_path):
    savemat(tmp_path / "rig.mat", {"a": np.arange(50.0), "f": np.arange(40.0)})
    with pytest.raises(InputError, match=r"rig.mat=40 samples of 'f', 50 of 'a': must be columns of one length"):
        MatFormat().read(tmp_path / "rig.mat", {"data.force.1": "f", "data.acceleration.1": "a"})
    assert list(MatFormat().read(tmp_path / "rig.mat").columns) == ["a"]


def test_version_7_3_by_hdf5storage(tmp_path):
    hdf5storage = pytest.importorskip("hdf5storage")
    content = {
        "t": NINE,
        "whole": np.arange(9, dtype=np.int16),
        "acc": np.stack([NINE, -NINE], axis=1),
        "rig": {"day": {"f": 3.0 * NINE}},
        "name": "frame",
        "on": NINE > 3.0,
    }
    hdf5storage.savemat(str(tmp_path / "rig.mat"), content, format="7.3")
    wanted = ["t", "whole", "acc.2", "rig.day.f", "on"]
    table = MatFormat().read(tmp_path / "rig.mat", {f"data.{i}": name for i, name in enumerate(wanted)})
    for name, values in zip(wanted, [NINE, np.arange(9.0), -NINE, 3.0 * NINE, NINE > 3.0], strict=True):
        np.testing.assert_array_equal(table.columns[name], values)
    assert "holds text" in message(tmp_path / "rig.mat", "name")


def test_structures_of_version_7_3_as_matlab_writes_them(tmp_path):
    """Fields of an array of structures are references into #refs#; an empty array is its own shape as numbers."""
    with h5py.File(tmp_path / "rig.mat", "w", userblock_size=512) as file:
        parts = [file.create_dataset(f"#refs#/{letter}", data=values[None, :]) for letter, values in
                 (("a", NINE), ("b", 2.0 * NINE))]  # fmt: skip
        for part in parts:
            part.attrs["MATLAB_class"] = np.bytes_("double")
        group = file.create_group("channels")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        group.create_dataset("y", data=np.array([[part.ref for part in parts]], dtype=h5py.ref_dtype))
        file["cells"] = np.array([[parts[0].ref]], dtype=h5py.ref_dtype)
        file["cells"].attrs["MATLAB_class"] = np.bytes_("cell")
        file["empty"] = np.array([0, 0], dtype=np.uint64)
        file["empty"].attrs.update({"MATLAB_class": np.bytes_("double"), "MATLAB_empty": np.uint8(1)})
    with (tmp_path / "rig.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    table = MatFormat().read(tmp_path / "rig.mat", {"data.force.1": "channels.2.y"})
    np.testing.assert_array_equal(table.columns["channels.2.y"], 2.0 * NINE)
    assert "holds cells" in message(tmp_path / "rig.mat", "cells")
    assert "is 0 × 0" in message(tmp_path / "rig.mat", "empty")


def test_only_what_is_asked_for_is_unpacked(tmp_path):
    """A packed variable that is wrong inside is no matter to a record that does not ask for it."""
    big = {"rig": {"noise": np.random.default_rng(0).normal(size=3000)}}
    savemat(tmp_path / "rig.mat", {"a": NINE, **big}, do_compression=True)
    content = bytearray((tmp_path / "rig.mat").read_bytes())
    content[-3000] ^= 0xFF
    (tmp_path / "rig.mat").write_bytes(content)
    np.testing.assert_array_equal(MatFormat().read(tmp_path / "rig.mat", {"data.time": "a"}).columns["a"], NINE)
    assert "must be a MAT file that is whole; damaged or cut off?" in message(tmp_path / "rig.mat", "rig.noise")
