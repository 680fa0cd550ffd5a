"""netCDF files, of version 4, which is HDF5, by h5py, and 3 by SciPy: variables by their path."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pinn_cli.record.files.hdf5 import Hdf5Format, arrays_of
from pinn_cli.record.files.table import SensorHint
from pinn_cli.record.files.variables import Variable, content_of

_VERSION_3 = (b"CDF\x01", b"CDF\x02")


class NetcdfFormat(Hdf5Format):
    """Vectors ``a1`` and columns of matrices ``acceleration.3``, unpacked; in a group ``rig/a1``.

    Numbers that the file marks as missing, or stores scaled, are read as netCDF's own conventions say
    (``_FillValue``, ``missing_value``, ``scale_factor``, ``add_offset``).
    """

    name = "netcdf"
    suffixes = (".nc", ".nc4", ".cdf")
    other_suffixes = (".h5",)
    expected = "a netCDF file"

    def begins(self, content: bytes) -> bool:
        """See :class:`ArrayFormat`."""
        return content.startswith(_VERSION_3) or super().begins(content)

    def variables(self, path: Path, wanted: Collection[str] | None) -> Mapping[str, Variable]:
        """See :class:`ArrayFormat`; paths may begin with a slash."""
        with path.open("rb") as file:
            if file.read(4) not in _VERSION_3:
                import h5py

                return arrays_of(h5py.File(path, "r"), lambda node: _unpacked(node[()], node.attrs))
        from scipy.io import netcdf_file

        variables = {}
        for name, variable in netcdf_file(str(path), "r", mmap=False).variables.items():
            attributes = vars(variable)  # attributes of the file are those of the object
            unit = attributes.get("units", b"")
            text = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else str(unit)
            read = partial(_unpacked, variable.data, attributes)
            variables[name] = Variable(variable.shape, read, content_of(variable.data.dtype), SensorHint(text))
        return variables | {f"/{name}": variable for name, variable in variables.items()}


def _unpacked(stored: np.ndarray, attributes: Mapping[str, Any]) -> np.ndarray:
    """Numbers as they were before they were packed, NaN where there is none."""
    values = np.asarray(stored).astype(np.float64)
    for name in ("_FillValue", "missing_value"):
        if name in attributes:
            values = np.where(np.isin(stored, np.ravel(attributes[name])), np.nan, values)
    scale, offset = (np.ravel(attributes.get(n, d))[0] for n, d in (("scale_factor", 1.0), ("add_offset", 0.0)))
    return np.asarray(values * float(scale) + float(offset))
