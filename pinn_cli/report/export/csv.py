"""The response as text, a column each."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from pinn_cli.report.export.base import Export, histories
from pinn_cli.runs.writing import write_table

if TYPE_CHECKING:
    import xarray as xr


class CsvExport(Export):
    """Columns ``t``, ``displacement_1``, ``displacement_1_std`` and so on, s and SI units, ten significant digits."""

    name = "csv"

    def write(self, dataset: xr.Dataset, path: Path) -> None:
        """See :class:`Export`."""
        columns = {"t": dataset["time"].values}
        for history in histories(dataset):
            name = f"{history.quantity}_{history.dof}"
            columns |= {name: history.estimate, f"{name}_std": history.std}
        write_table(pd.DataFrame(columns), path)
