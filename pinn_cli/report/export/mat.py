"""The response as a MAT file, for MATLAB and Octave."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.response import QUANTITIES
from pinn_cli.report.export.base import Export, histories
from pinn_cli.runs.writing import write_bytes

if TYPE_CHECKING:
    import xarray as xr


class MatExport(Export):
    """Version 5: ``t`` (N × 1, s), ``displacement``, ``displacement_std`` and so on (N × DOFs), ``dof`` (their names).

    ``units`` is a structure with the unit of every quantity.
    """

    name = "mat"

    def write(self, dataset: xr.Dataset, path: Path) -> None:
        """See :class:`Export`."""
        from scipy.io import savemat

        every = list(histories(dataset))
        content: dict[str, object] = {"t": dataset["time"].values[:, None]}
        for quantity in QUANTITIES:
            of_quantity = [history for history in every if history.quantity == quantity]
            content[quantity] = np.stack([history.estimate for history in of_quantity], axis=1)
            content[f"{quantity}_std"] = np.stack([history.std for history in of_quantity], axis=1)
        content["dof"] = np.array(list(dict.fromkeys(history.dof for history in every)), dtype=object)
        content["units"] = {history.quantity: history.unit for history in every} | {"t": "s"}
        file = BytesIO()
        savemat(file, content, do_compression=True)
        write_bytes(file.getvalue(), path)
