"""The formats that the program reads, and which of them a file's suffix tells."""

from __future__ import annotations

from pathlib import Path

from pinn_cli.record.files.base import FileFormat
from pinn_cli.record.files.csv import CsvFormat
from pinn_cli.record.files.hdf5 import Hdf5Format
from pinn_cli.record.files.mat import MatFormat
from pinn_cli.record.files.netcdf import NetcdfFormat
from pinn_cli.record.files.parquet import ParquetFormat
from pinn_cli.record.files.tdms import TdmsFormat
from pinn_cli.record.files.uff import UffFormat

FORMATS: tuple[type[FileFormat], ...] = (
    CsvFormat, MatFormat, UffFormat, ParquetFormat, TdmsFormat, Hdf5Format, NetcdfFormat,
)  # fmt: skip


def format_of(path: Path, chosen: FileFormat) -> FileFormat:
    """The chosen format, unless the file's suffix is none of its own and that of another.

    Args:
        path: Of the file.
        chosen: By ``data=...``.
    """
    suffix = (path.with_suffix("") if path.suffix.lower() == ".gz" else path).suffix.lower()
    if suffix in (*chosen.suffixes, *chosen.other_suffixes):
        return chosen
    return next((other() for other in FORMATS if suffix in other.suffixes), chosen)
