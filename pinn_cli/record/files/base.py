"""What every format of a file is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

from pinn_cli.record.files.table import Table


class FileFormat(ABC):
    """How numbers lie in a file.

    A format reads numbers and runs nothing: it unpickles no object and evaluates no formula.

    Attributes:
        name: As in ``data=NAME``.
        suffixes: Of files in this format, in small letters, with the point.
        tells_time: Whether the files' header may say when the samples were taken.
    """

    name: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]]
    tells_time: ClassVar[bool] = False

    @abstractmethod
    def read(self, path: Path, wanted: Mapping[str, str] | None = None) -> Table:
        """The columns of a file.

        Args:
            path: Of the file.
            wanted: Setting to the name of the column that it asks for; None: every column that has numbers.

        Raises:
            InputError: The file is missing, cannot be read or is in another format, or lacks a column.
        """
