"""Parquet files, by pyarrow: columns by their name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pinn_cli.record.files.base import FileFormat
from pinn_cli.record.files.on_disk import beginning, check_size, damaged, other_format
from pinn_cli.record.files.table import SensorHint, Table, check_names
from pinn_cli.settings.errors import InputError

_EXPECTED = "a Parquet file"


class ParquetFormat(FileFormat):
    """Columns of whole or floating-point numbers; a null is an empty cell."""

    name = "parquet"
    suffixes = (".parquet", ".pq")

    def read(self, path: Path, wanted: Mapping[str, str] | None = None) -> Table:
        """See :class:`FileFormat`."""
        content = beginning(path)
        if not content.startswith(b"PAR1"):
            raise other_format(path, content, _EXPECTED)
        parquet, arrow = self.package("pyarrow.parquet"), self.package("pyarrow")
        try:
            with parquet.ParquetFile(path) as file:
                fields = {field.name: field for field in file.schema_arrow}
                names = _wanted(arrow, path, file.schema_arrow, fields, wanted)
                check_size(path, 8 * file.metadata.num_rows * len(names))
                read = file.read(columns=names)
                columns = {name: _numbers(arrow, read.column(name)) for name in names}
        except InputError:
            raise
        except (OSError, ValueError, arrow.ArrowException) as error:
            raise damaged(path, _EXPECTED, error) from None
        units = {name: (fields[name].metadata or {}).get(b"unit", b"").decode("utf-8", "replace") for name in names}
        return Table(path, columns, hints={name: SensorHint(unit) for name, unit in units.items() if unit})


def _wanted(
    arrow: Any, path: Path, schema: Any, fields: Mapping[str, Any], wanted: Mapping[str, str] | None
) -> list[str]:
    """Names of the columns to read."""
    if wanted is None:
        return [name for name, field in fields.items() if _is_number(arrow, field.type)]
    check_names(path, wanted, list(fields))
    counts = Counter(schema.names)
    for setting, name in wanted.items():
        if counts[name] > 1:
            hint = f"it is there {counts[name]} times: give each its own name"
            raise InputError(setting, repr(name), f"the name of one column of {path.name}", hint)
        if not _is_number(arrow, fields[name].type):
            hint = f"in {path.name} it holds {fields[name].type}; write times as seconds, and true and false as 1 and 0"
            raise InputError(setting, repr(name), "a column of numbers", hint)
    return list(dict.fromkeys(wanted.values()))


def _is_number(arrow: Any, kind: Any) -> bool:
    types = arrow.types
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind))


def _numbers(arrow: Any, column: Any) -> np.ndarray:
    numbers = column.cast(arrow.float64(), safe=False).to_numpy(zero_copy_only=False)
    return np.asarray(numbers, dtype=np.float64)
