"""HDF5 files, by h5py: arrays by their path."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from pinn_cli.record.files.file_format import ArrayFormat
from pinn_cli.record.files.table import SensorHint
from pinn_cli.record.files.variables import Variable, content_of

if TYPE_CHECKING:
    import h5py

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
# What netCDF writes for a dimension that has no coordinates.
_ONLY_DIMENSION = b"This is a netCDF dimension but not a netCDF variable"


class Hdf5Format(ArrayFormat):
    """Vectors ``rig/a1``, columns of matrices ``rig/acc.2`` and fields of compound arrays ``rig/table.a1``."""

    name = "hdf5"
    suffixes: ClassVar[tuple[str, ...]] = (".h5", ".hdf5", ".hdf")
    other_suffixes: ClassVar[tuple[str, ...]] = (".mat", ".nc")
    expected = "an HDF5 file"

    def begins(self, content: bytes) -> bool:
        """See :class:`ArrayFormat`; what another program wrote may stand in front."""
        return any(content.startswith(_SIGNATURE, start) for start in (0, 512, 1024, 2048))

    def variables(self, path: Path, wanted: Collection[str] | None) -> Mapping[str, Variable]:
        """See :class:`ArrayFormat`; paths may begin with a slash."""
        import h5py

        return arrays_of(h5py.File(path, "r"), lambda node: node[()])


def arrays_of(file: h5py.File, read: Callable[[h5py.Dataset], np.ndarray]) -> dict[str, Variable]:
    """Every array of a file by its path; fields of compound ones are ``path.field``.

    Links to other places and files are not followed.
    """
    variables: dict[str, Variable] = {}

    def visit(path: str, node: Any) -> None:
        name = node.attrs.get("NAME", b"")
        if not hasattr(node, "dtype") or node.shape is None or (isinstance(name, bytes) and _ONLY_DIMENSION in name):
            return
        if node.dtype.names is None:
            variables[path] = Variable(node.shape, lambda: read(node), content_of_node(node), SensorHint(_unit(node)))
        for field in node.dtype.names or ():
            content = content_of_node(node, field)
            variables[f"{path}.{field}"] = Variable(node.shape, partial(node.__getitem__, field), content)

    file.visititems(visit)
    return variables | {f"/{path}": variable for path, variable in variables.items()}


def content_of_node(node: h5py.Dataset, field: str | None = None) -> str:
    """What an array, or a field of a compound one, holds instead of real numbers; "" of those."""
    if node.external or node.is_virtual:
        return "data of another file"
    return content_of(node.dtype if field is None else node.dtype[field])


def _unit(node: h5py.Dataset) -> str:
    texts = (node.attrs.get(name) for name in ("units", "unit", "Units", "Unit"))
    text = next((text for text in texts if isinstance(text, bytes | str)), "")
    return text.decode("utf-8", "replace") if isinstance(text, bytes) else text
