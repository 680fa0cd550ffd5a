"""Matrices from files of other programs."""

import numpy as np
import pytest
from beams import beam
from refusals import refusal
from scipy.io import mmwrite, savemat
from scipy.sparse import save_npz

from pinn_cli.settings.errors import InputError
from pinn_cli.system.matrix_files import read_matrices

NOTHING = {"M": None, "K": None, "C": None}


@pytest.fixture
def folder(tmp_path):
    M, K = beam(3)
    np.savez(tmp_path / "dense.npz", M=M.toarray(), K=K.toarray(), C=0.1 * M.toarray())
    savemat(tmp_path / "model.mat", {"M": M, "K": K.toarray()})
    for name, matrix in {"M": M, "K": K}.items():
        save_npz(tmp_path / f"{name}.npz", matrix)
        mmwrite(tmp_path / f"{name}.mtx", matrix)
        savemat(tmp_path / f"{name}.mat", {"stored": matrix})
        np.save(tmp_path / f"{name}.npy", matrix.toarray())
    return tmp_path


@pytest.mark.parametrize(
    ("files", "path", "names"),
    [
        (NOTHING, "dense.npz", ["M", "K", "C"]),
        pytest.param(NOTHING, "model.mat", ["M", "K"], marks=pytest.mark.apart),
        ({"M": "M.npz", "K": "K.npz", "C": None}, None, ["M", "K"]),
        ({"M": "M.mtx", "K": "K.mtx", "C": None}, None, ["M", "K"]),
        ({"M": "M.mat", "K": "K.mat", "C": None}, None, ["M", "K"]),
        ({"M": "M.npy", "K": "K.npy", "C": None}, None, ["M", "K"]),
        ({"M": None, "K": None, "C": "M.mtx"}, "model.mat", ["M", "K", "C"]),
    ],
)
def test_every_kind_of_file_gives_the_same_matrices(folder, files, path, names):
    found = read_matrices(files, path, folder)
    assert list(found) == names
    for name, expected in zip("MK", beam(3), strict=True):
        np.testing.assert_allclose(found[name].toarray(), expected.toarray(), rtol=1e-12)


@pytest.mark.parametrize(
    ("files", "path", "setting", "said"),
    [
        ({"M": "absent.npz"}, None, "system.M", "there is none at"),
        ({"M": "M.csv"}, None, "system.M", "ends in .npz, .npy, .mtx, .mat"),
        ({"M": None}, "M.mtx", "system.path", "give it as system.M"),
        ({"M": None}, "M.npy", "system.path", "give it as system.M"),
        ({"X": None}, "dense.npz", "system.path", "no matrix called X"),
        ({"M": "broken.npz"}, None, "system.M", "a readable .npz file"),
        ({"M": "broken.mat"}, None, "system.M", "a readable .mat file"),
        pytest.param({"M": "broken.mtx"}, None, "system.M", "a readable .mtx file", marks=pytest.mark.apart),
        ({"M": "objects.npz"}, None, "system.M", "a readable .npz file"),
        ({"M": "wide.npz"}, None, "system.M", "a square matrix"),
        ({"M": "triangle.npz"}, None, "system.M", "only one triangle"),
        ({"M": "nan.npz"}, None, "system.M", "finite numbers"),
        ({"M": "complex.npz"}, None, "system.M", "real numbers"),
        ({"M": "M.npz", "K": "large.npz"}, None, "system.K", "as large as M, 6 x 6"),
    ],
)
def test_what_is_no_matrix_is_refused_in_one_line(folder, files, path, setting, said):
    for suffix in ("npz", "mat", "mtx"):
        (folder / f"broken.{suffix}").write_bytes(b"nothing of the kind")
    one = np.eye(3)
    arrays = {
        "objects": np.array([{}], dtype=object), "wide": np.ones((2, 3)), "triangle": np.triu(one + 1),
        "nan": one * np.nan, "complex": one * 1j, "large": np.eye(7),
    }  # fmt: skip
    for name, array in arrays.items():
        np.savez(folder / f"{name}.npz", M=array)
    told = refusal(read_matrices, files, path, folder)
    assert told.startswith(f"{setting}=")
    assert said in told


@pytest.mark.apart
def test_a_file_that_asks_for_more_than_the_machine_has_ends_its_reader_alone(folder):
    (folder / "vast.mtx").write_text("%%MatrixMarket matrix array real general\n2000000 2000000\n1.0\n")
    with pytest.raises(InputError, match=r"^system\.K=vast\.mtx") as error:
        read_matrices({"M": "M.npz", "K": "vast.mtx"}, None, folder)
    assert "\n" not in str(error.value)
