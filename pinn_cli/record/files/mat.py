"""MAT files of MATLAB and Octave: up to version 7 by SciPy, 7.3, which is HDF5, by h5py."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pinn_cli.record.files.file_format import FIRST_BYTES
from pinn_cli.record.files.hdf5 import Hdf5Format, content_of_node
from pinn_cli.record.files.variables import Variable, content_of

if TYPE_CHECKING:
    import h5py

_REFERENCES = "#refs#"
_CLASSES = {"char": "text", "cell": "cells", "function_handle": "a function"}
# How deep structures may lie in structures.
_DEEPEST = 20


class MatFormat(Hdf5Format):
    """Vectors and channels of matrices, by name: ``acc``, ``acc.2``; fields of structures ``rig.acc``.

    Element i of an array of structures is ``rig.2.acc``. Cells, objects, function handles and text are no numbers.
    """

    name = "mat"
    suffixes = (".mat",)
    other_suffixes = ()
    expected = "a MAT file"

    def begins(self, content: bytes) -> bool:
        """See :class:`ArrayFormat`."""
        marked = content.startswith(b"MATLAB") or content[126:128] in (b"IM", b"MI")
        return marked or _is_version_4(content) or super().begins(content)

    def variables(self, path: Path, wanted: Collection[str] | None) -> Mapping[str, Variable]:
        """See :class:`ArrayFormat`; only variables that are asked for are unpacked."""
        with path.open("rb") as file:
            if super().begins(file.read(FIRST_BYTES)):
                import h5py

                opened = h5py.File(path, "r")
                return dict(_nodes(opened, "", opened, 0))
        from scipy.io import loadmat

        roots = None if wanted is None else {name.partition(".")[0] for name in wanted}
        loaded = loadmat(str(path), appendmat=False, variable_names=roots)
        if roots is not None and not roots <= loaded.keys():  # an error lists all that there are
            loaded = loadmat(str(path), appendmat=False)
        nested = (_parts(name, value, 0) for name, value in loaded.items() if not name.startswith("__"))
        return {name: variable for parts in nested for name, variable in parts}


def _is_version_4(content: bytes) -> bool:
    """Whether it begins with the type of a variable, MOPT: M is the byte order, P the precision, T the kind."""
    types = {int.from_bytes(content[:4], order) for order in ("little", "big")} if len(content) >= 20 else set()
    return any(m <= 4000 and m // 1000 in (0, 1) and m // 100 % 10 == 0 and m % 10 <= 2 for m in types)


def _parts(name: str, value: Any, depth: int) -> Iterator[tuple[str, Variable]]:
    """A variable that SciPy read, or the fields of a structure."""
    from scipy.io import matlab

    others = {matlab.MatlabFunction: "a function", matlab.MatlabObject: "an object", matlab.MatlabOpaque: "an object"}
    content = others.get(type(value), "" if isinstance(value, np.ndarray) else "a sparse matrix")
    if not content and value.dtype.names and depth < _DEEPEST:
        elements = value.ravel(order="F")
        for number, element in enumerate(elements, start=1):
            for field in value.dtype.names:
                prefix = name if len(elements) == 1 else f"{name}.{number}"
                yield from _parts(f"{prefix}.{field}", element[field], depth + 1)
        return
    content = content or ("cells" if value.dtype == object else content_of(value.dtype))
    yield name, Variable(value.shape, lambda: value, content)


def _nodes(file: h5py.File, name: str, node: Any, depth: int) -> Iterator[tuple[str, Variable]]:
    """A variable of version 7.3, or the fields of a structure, in MATLAB's order of axes."""
    import h5py

    kind = node.attrs.get("MATLAB_class", b"")
    kind = kind.decode() if isinstance(kind, bytes) else str(kind)
    if "MATLAB_sparse" in node.attrs:
        yield name, Variable((), lambda: np.empty(0), "a sparse matrix")
    elif isinstance(node, h5py.Group):
        for field in node if depth < _DEEPEST else ():
            if field != _REFERENCES and isinstance(node.get(field, getlink=True), h5py.HardLink):
                yield from _nodes(file, f"{name}.{field}".lstrip("."), node[field], depth + 1)
    elif node.dtype == h5py.ref_dtype and kind != "cell":  # a field of an array of structures
        root, _, field = name.rpartition(".")
        for number, reference in enumerate(np.ravel(np.transpose(node[()])), start=1):
            if reference and depth < _DEEPEST:
                yield from _nodes(file, f"{root}.{number}.{field}", file[reference], depth + 1)
    elif node.attrs.get("MATLAB_empty", 0):
        yield name, Variable((0, 0), lambda: np.empty((0, 0)))
    else:
        content = "an object" if "MATLAB_object_decode" in node.attrs else content_of_node(node)
        yield name, Variable(node.shape[::-1], lambda: np.transpose(node[()]), _CLASSES.get(kind, content))
