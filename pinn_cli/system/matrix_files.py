"""Matrices of a finite-element model, as other programs save them: ``.npz``, ``.npy``, ``.mtx``, ``.mat``.

They are read in a process of its own, see :mod:`pinn_cli.runs.apart`, which imports this file and nothing that is slow.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, mmread
from scipy.io.matlab import MatReadError
from scipy.sparse import csc_matrix, issparse, load_npz

from pinn_cli.runs.apart import Answer, UnreadableError, read_apart
from pinn_cli.runs.process import of_this_machine
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import located

SUFFIXES = (".npz", ".npy", ".mtx", ".mat")
# What numpy and scipy raise for files that are not what their names say.
_UNREADABLE = (
    OSError,
    ValueError,
    TypeError,
    KeyError,
    EOFError,
    NotImplementedError,
    zipfile.BadZipFile,
    MatReadError,
)
# A matrix counts as symmetric if it differs from its transpose by no more than this part of its largest entry.
SYMMETRIC = 1e-8
# Of the memory, the part that the matrices of a model may take as they are read: dense ones are held several times.
_PART_OF_MEMORY = 4


def read_matrices(
    files: Mapping[str, Any], path: Any, base: Path | None = None, settings: Mapping[str, str] | None = None
) -> dict[str, csc_matrix]:
    """Square symmetric matrices of one size, by their names.

    Args:
        files: Name (``M``) to the file that holds it alone; None: it is looked for in ``path``.
        path: One file, ``.npz`` or ``.mat``, that holds matrices by their names; None: there is none.
        base: The folder that relative paths start from; None: the current one.
        settings: Name to the setting that gives its file; None: ``system.<name>``.

    Returns:
        Of the names that were found.

    Raises:
        InputError: Naming the setting or ``system.path``: a file that cannot be read, or a matrix that is not
            square, symmetric, finite and of the size of the others.
    """
    asked = []
    for name, file in files.items():
        own_setting = f"system.{name}" if settings is None else settings[name]
        setting, given = ("system.path", path) if file is None else (own_setting, file)
        if given is not None:
            asked.append((setting, str(_file(setting, given, base)), name, file is not None))
    matrices: dict[str, csc_matrix] = {}
    places, memory, at = [Path(file) for _, file, *_ in asked], of_this_machine() / _PART_OF_MEMORY, 0
    try:
        for shape, parts in read_apart(stored, [asked], places, memory) if asked else ():
            if shape:
                matrices[asked[at][2]] = csc_matrix(tuple(parts), shape=shape)
            at += 1  # what is not answered is what cannot be read
    except UnreadableError as error:
        setting, file, *_ = asked[at]
        raise InputError(setting, Path(file).name, "a file of matrices that can be read", str(error)) from None
    sizes = {name: matrix.shape[0] for name, matrix in matrices.items()}
    for name, size in sizes.items():
        first = next(iter(sizes))
        if size != sizes[first]:
            shape = f"{size} x {size}"
            raise InputError(f"system.{name}", shape, f"as large as {first}, {sizes[first]} x {sizes[first]}")
    return matrices


def stored(asked: Sequence[tuple[str, str, str, bool]]) -> Iterator[Answer]:
    """What the other process answers of each matrix: its shape and parts; of one that is not there an empty shape.

    ``asked`` are setting, file and name of each, and whether it is to be alone in its file.
    """
    for setting, file, name, alone in asked:
        matrix = _matrix(setting, Path(file), name, alone)
        checked = None if matrix is None else _checked(setting, name, matrix)
        yield ([], []) if checked is None else (list(checked.shape), [checked.data, checked.indices, checked.indptr])


def _file(setting: str, given: Any, base: Path | None) -> Path:
    if not isinstance(given, str) or Path(given).suffix.lower() not in SUFFIXES:
        raise InputError(setting, given, f"the name of a file that ends in {', '.join(SUFFIXES)}")
    file = located(given, base)
    if not file.is_file():
        raise InputError(setting, given, "a file that exists", f"there is none at {file}")
    return file


def _matrix(setting: str, file: Path, name: str, alone: bool) -> Any:
    """The matrix as it was saved; None where a file of several has none of that name."""
    reader: dict[str, Callable[[Path, str, bool], Any]] = {
        ".npz": _of_npz,
        ".npy": partial(_of_one, partial(np.load, allow_pickle=False)),
        ".mtx": partial(_of_one, mmread),
        ".mat": _of_mat,
    }
    try:
        return reader[file.suffix.lower()](file, name, alone)
    except _UNREADABLE as error:
        hint = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(setting, file.name, f"a readable {file.suffix} file with the matrix {name}", hint) from None


def _of_npz(file: Path, name: str, alone: bool) -> Any:
    """A sparse matrix as scipy saves it, or an array as numpy does."""
    with np.load(file, allow_pickle=False) as arrays:
        if "indptr" in arrays.files and "format" in arrays.files:
            return load_npz(file)
        # Only these are read: another array of the file may be no numbers.
        wanted = [name] if name in arrays.files else arrays.files if alone and len(arrays.files) == 1 else []
        return _chosen({key: arrays[key] for key in wanted}, name, alone)


def _of_mat(file: Path, name: str, alone: bool) -> Any:
    arrays = loadmat(str(file), variable_names=None if alone else [name], spmatrix=True)
    return _chosen({key: value for key, value in arrays.items() if not key.startswith("__")}, name, alone)


def _of_one(read: Callable[[str], Any], file: Path, name: str, alone: bool) -> Any:
    """Of a format that holds one matrix, without a name."""
    if not alone:
        raise ValueError(f"it holds one matrix only: give it as system.{name}")
    return read(str(file))


def _chosen(arrays: Mapping[str, Any], name: str, alone: bool) -> Any:
    if name in arrays:
        return arrays[name]
    if alone and len(arrays) == 1:
        return next(iter(arrays.values()))
    if alone or name != "C":
        raise ValueError(f"it has no matrix called {name}")
    return None


def _checked(setting: str, name: str, matrix: Any) -> csc_matrix:
    """As a sparse matrix of numbers that is square, finite and symmetric."""
    dense = matrix if issparse(matrix) else np.asarray(matrix)
    if dense.dtype.kind not in "fiu":
        raise InputError(setting, f"{name} of {dense.dtype}", "a matrix of real numbers")
    if dense.ndim != 2 or dense.shape[0] != dense.shape[1] or not dense.shape[0]:
        raise InputError(setting, f"{name} of shape {dense.shape}", "a square matrix")
    sparse = csc_matrix(dense, dtype=np.float64)
    if not np.isfinite(sparse.data).all():
        raise InputError(setting, f"{name} with NaN or infinity", "a matrix of finite numbers")
    size = float(np.abs(sparse.data).max(initial=0.0))
    skew = abs(sparse - sparse.T)
    if skew.nnz and float(skew.data.max()) > SYMMETRIC * size:
        far = f"{name} and its transpose differ by {float(skew.data.max()) / size:.2g} of its largest entry"
        raise InputError(setting, far, "a symmetric matrix", "is only one triangle of it stored?")
    return csc_matrix((sparse + sparse.T) * 0.5)
