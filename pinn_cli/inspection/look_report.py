"""What a look at records has found: ``pinn-run inspect`` and ``modes`` print and write it, Python has it as it is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from pinn_cli.runs.workbook import write_workbook
from pinn_cli.runs.writing import write_table
from pinn_cli.settings.errors import InputError, suggestion

if TYPE_CHECKING:
    import os

    import pandas as pd
    from matplotlib.figure import Figure


class LookReport(ABC):
    """Tables and figures by the names of their files, and the text that the command prints."""

    @property
    @abstractmethod
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """Name to table."""

    @property
    @abstractmethod
    def drawings(self) -> Mapping[str, Callable[[], Figure]]:
        """Name to what draws the figure."""

    @abstractmethod
    def text(self) -> str:
        """What the command prints."""

    @property
    def spectra(self) -> pd.DataFrame:
        """Power spectral densities, frequency responses and coherences over frequency, units in the columns' names."""
        return self.tables["spectra"]

    def figure(self, name: str = "") -> Figure:
        """A matplotlib figure, which a notebook shows.

        Args:
            name: Of `drawings`; "": the first of them.

        Raises:
            InputError: There is none of that name.
        """
        from pinn_cli.report.figures.style import for_notebooks

        name = name or next(iter(self.drawings))
        if name not in self.drawings:
            raise InputError("figure", name, f"one of {', '.join(self.drawings)}", suggestion(name, self.drawings))
        return for_notebooks(self.drawings[name]())

    def write(self, directory: Path, figures: bool = True) -> None:
        """Write every table as CSV and, if they are wanted, the figures under ``figures``."""
        for name, table in self.tables.items():
            write_table(table, directory / f"{name}.csv")
        if figures:
            from pinn_cli.report.figures.style import save

            for name, draw in self.drawings.items():
                save(draw(), directory / "figures", name)

    def to_excel(self, path: str | os.PathLike[str]) -> Path:
        """Write an Excel file (.xlsx) with a sheet for each table.

        Raises:
            InputError: It has another suffix, a table has more rows than a sheet, or openpyxl is not installed.
            WriteError: The disk does not take it.
        """
        return write_workbook(self.tables, path)

    def __repr__(self) -> str:
        return self.text()
