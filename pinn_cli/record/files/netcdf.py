"""netCDF files, of version 4 (which is HDF5) and 3: variables by their path."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pinn_cli.record.files.arrays import Variable, as_float, table_of
from pinn_cli.record.files.base import FileFormat
from pinn_cli.record.files.hdf5_tree import opened, variables_of, with_slashes
from pinn_cli.record.files.on_disk import beginning, damaged
from pinn_cli.record.files.table import Table
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    import h5py

_EXPECTED = "a netCDF file"


class NetcdfFormat(FileFormat):
    """Vectors ``a1`` and columns of matrices ``acceleration.3``, unpacked; in a group ``rig/a1``.

    Numbers that the file marks as missing, or stores scaled, are read as netCDF's own conventions say
    (``_FillValue``, ``missing_value``, ``scale_factor``, ``add_offset``).
    """

    name = "netcdf"
    suffixes = (".nc", ".nc4", ".cdf")
    other_suffixes = (".h5",)

    def read(self, path: Path, wanted: Mapping[str, str] | None = None) -> Table:
        """See :class:`FileFormat`."""
        if beginning(path).startswith((b"CDF\x01", b"CDF\x02")):
            return table_of(path, with_slashes(_of_version_3(path), wanted), wanted)
        with opened(path, _EXPECTED) as file:
            return table_of(path, with_slashes(variables_of(file, _reader), wanted), wanted)


def _reader(node: h5py.Dataset) -> Callable[[], np.ndarray]:
    return lambda: _unpacked(node[()], node.attrs)


def _of_version_3(path: Path) -> dict[str, Variable]:
    from scipy.io import netcdf_file

    try:
        with netcdf_file(str(path), "r", mmap=False) as file:
            found = {}
            for name, variable in file.variables.items():
                attributes, array = dict(variable._attributes), np.array(variable[:])
                unit = attributes.get("units", b"")
                text = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else str(unit)
                if array.dtype.kind in "iuf":
                    array = _unpacked(array, attributes)
                found[name] = Variable.of(array, text)
            return found
    except InputError:
        raise
    except Exception as error:  # SciPy raises a dozen kinds of a file that is cut off
        raise damaged(path, _EXPECTED, error) from None


def _unpacked(stored: np.ndarray, attributes: Mapping[str, Any]) -> np.ndarray:
    """Numbers as they were before they were packed, NaN where there is none."""
    values = as_float(stored)
    for name in ("_FillValue", "missing_value"):
        if name in attributes:
            values = np.where(np.isin(stored, np.ravel(attributes[name])), np.nan, values)
    scale, offset = (np.ravel(attributes.get(n, d))[0] for n, d in (("scale_factor", 1.0), ("add_offset", 0.0)))
    return np.asarray(values * float(scale) + float(offset))
