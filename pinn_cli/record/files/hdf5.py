"""HDF5 files: arrays by their path."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pinn_cli.record.files.arrays import table_of
from pinn_cli.record.files.base import FileFormat
from pinn_cli.record.files.hdf5_tree import opened, variables_of, with_slashes
from pinn_cli.record.files.table import Table


class Hdf5Format(FileFormat):
    """Vectors ``rig/a1``, columns of matrices ``rig/acc.2`` and fields of compound arrays ``rig/table.a1``."""

    name = "hdf5"
    suffixes = (".h5", ".hdf5", ".hdf")
    other_suffixes = (".mat", ".nc")

    def read(self, path: Path, wanted: Mapping[str, str] | None = None) -> Table:
        """See :class:`FileFormat`."""
        with opened(path, "an HDF5 file") as file:
            return table_of(path, with_slashes(variables_of(file), wanted), wanted)
