"""What lies in an HDF5 file, by path: only what the file itself holds, numbers only."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pinn_cli.record.files.arrays import Variable, as_float, content_of
from pinn_cli.record.files.on_disk import beginning, damaged, other_format
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    import h5py

HDF5 = b"\x89HDF\r\n\x1a\n"
_REFERENCES = "#refs#"
_OF_MATLAB = {"char": "text", "cell": "cells", "function_handle": "a function"}


@contextmanager
def opened(path: Path, expected: str) -> Iterator[h5py.File]:
    """An HDF5 file, to be read.

    Args:
        path: Of the file.
        expected: What it should be, for errors.

    Raises:
        InputError: It is none, or is damaged; within the block too.
    """
    import h5py

    content = beginning(path)
    if not content.startswith((HDF5, b"MATLAB 7.3")) and not h5py.is_hdf5(path):
        raise other_format(path, content, expected)
    try:
        with h5py.File(path, "r") as file:
            yield file
    except InputError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise damaged(path, expected, error) from None


def variables_of(
    file: h5py.File, decoded: Callable[[h5py.Dataset], Callable[[], np.ndarray]] | None = None
) -> dict[str, Variable]:
    """Every array of a file by its path, without the first slash; a field of a compound one is ``path.field``.

    Links to other places and files are not followed.

    Args:
        file: That is open.
        decoded: From an array to what reads its numbers; None: as they are stored.
    """
    found: dict[str, Variable] = {}

    def visit(path: str, node: Any) -> None:
        if not hasattr(node, "dtype") or node.shape is None or _is_only_dimension(node):  # or a group, or an empty one
            return
        if node.dtype.names is None:
            load = decoded(node) if decoded else _reader(node)
            found[path] = Variable(node.shape, load, _content(node), _unit(node))
            return
        for field in node.dtype.names:
            content = "" if not node.external and not node.is_virtual else "data of another file"
            content = content or content_of(node.dtype[field])
            found[f"{path}.{field}"] = Variable(node.shape, _reader(node, field), content)

    file.visititems(visit)
    return found


def variables_of_matlab(file: h5py.File) -> dict[str, Variable]:
    """Variables of a MAT file of version 7.3, by MATLAB's names and in its order of axes."""
    return {name: variable for key in file if key != _REFERENCES for name, variable in _matlab(file, key, file[key], 0)}


def _matlab(file: h5py.File, name: str, node: Any, depth: int) -> Iterator[tuple[str, Variable]]:
    import h5py

    if isinstance(node, h5py.Group):
        if "MATLAB_sparse" in node.attrs:
            yield name, Variable((), lambda: np.empty(0), "a sparse matrix")
            return
        for field in node:
            if field != _REFERENCES and depth < 20:
                yield from _matlab(file, f"{name}.{field}", node[field], depth + 1)
        return
    kind = node.attrs.get("MATLAB_class", b"")
    kind = kind.decode() if isinstance(kind, bytes) else str(kind)
    if node.dtype == h5py.ref_dtype and kind != "cell":  # a field of an array of structures
        root, _, field = name.rpartition(".")
        for number, reference in enumerate(np.ravel(node[()].T if node.ndim else node[()]), start=1):
            if reference and depth < 20:
                yield from _matlab(file, f"{root}.{number}.{field}", file[reference], depth + 1)
        return
    if node.attrs.get("MATLAB_empty", 0):
        yield name, Variable((0, 0), lambda: np.empty((0, 0)))
        return
    content = _OF_MATLAB.get(kind, "an object" if "MATLAB_object_decode" in node.attrs else _content(node))
    yield name, Variable(node.shape[::-1], lambda: as_float(node[()]).T, content)


def _reader(node: h5py.Dataset, field: str | None = None) -> Callable[[], np.ndarray]:
    return lambda: as_float(node[()] if field is None else node[field])


def _is_only_dimension(node: h5py.Dataset) -> bool:
    """Whether it stands for a dimension of netCDF that has no coordinates."""
    name = node.attrs.get("NAME", b"")
    return isinstance(name, bytes) and name.startswith(b"This is a netCDF dimension but not a netCDF variable")


def _content(node: h5py.Dataset) -> str:
    return "data of another file" if node.external or node.is_virtual else content_of(node.dtype)


def _unit(node: h5py.Dataset) -> str:
    for name in ("units", "unit", "Units", "Unit"):
        text = node.attrs.get(name)
        if isinstance(text, bytes | str):
            return text.decode("utf-8", "replace") if isinstance(text, bytes) else text
    return ""


def with_slashes(variables: dict[str, Variable], wanted: Mapping[str, str] | None) -> dict[str, Variable]:
    """The same variables, by ``/path`` too where that is how they are asked for."""
    asked = any(name.startswith("/") for name in (wanted or {}).values())
    return {**variables, **{f"/{name}": variable for name, variable in variables.items()}} if asked else variables
