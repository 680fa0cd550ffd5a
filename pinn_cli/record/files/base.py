"""What every format of a file is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from pinn_cli.record.files.table import Table
from pinn_cli.settings.errors import InputError


class FileFormat(ABC):
    """How numbers lie in a file.

    A format reads numbers and runs nothing: it unpickles no object and evaluates no formula.

    Attributes:
        name: As in ``data=NAME``, and the extra that brings the package it needs, if it needs one.
        suffixes: That tell this format, in small letters, with the point.
        other_suffixes: That such files may have too, although they tell another one.
        tells_time: Whether the files' header may say when the samples were taken.
    """

    name: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]]
    other_suffixes: ClassVar[tuple[str, ...]] = ()
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

    def package(self, module: str) -> Any:
        """A module of a package that need not be installed.

        Raises:
            InputError: It is not installed.
        """
        try:
            return import_module(module)
        except ModuleNotFoundError as error:
            if error.name != module.partition(".")[0]:
                raise
            allowed = f"a format whose package is installed; {self.name} needs {error.name}"
            raise InputError("data.format", self.name, allowed, f"pip install 'pinn-cli[{self.name}]'") from None
