"""Parquet files, by pyarrow: columns by their name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pinn_cli.record.files.file_format import ArrayFormat
from pinn_cli.record.files.table import SensorHint
from pinn_cli.record.files.variables import Variable


class ParquetFormat(ArrayFormat):
    """Columns of whole or floating-point numbers; a null is an empty cell."""

    name = "parquet"
    suffixes = (".parquet", ".pq")
    expected = "a Parquet file"
    beginnings = (b"PAR1",)
    package = "pyarrow"

    def variables(self, path: Path, wanted: Collection[str] | None) -> Mapping[str, Variable]:
        """See :class:`ArrayFormat`."""
        from pyarrow import parquet, types

        file = parquet.ParquetFile(path)
        counts = Counter(file.schema_arrow.names)
        variables = {}
        for field in file.schema_arrow:
            is_number = any(t(field.type) for t in (types.is_integer, types.is_floating, types.is_decimal))
            content = "" if is_number else str(field.type)
            if counts[field.name] > 1:
                content = f"{counts[field.name]} columns of this name"
            unit = (field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace")
            read = partial(_numbers, file, field.name)
            variables[field.name] = Variable((1, file.metadata.num_rows), read, content, SensorHint(unit))
        return variables


def _numbers(file: Any, name: str) -> np.ndarray:
    column = file.read(columns=[name], use_threads=False).column(name)
    return np.asarray(column.cast("float64", safe=False))
