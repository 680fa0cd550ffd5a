"""The response as a universal file, for programs of modal analysis."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pinn_cli.report.export.base import Export, History, histories
from pinn_cli.runs.writing import replacing
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

# Types of functions and data as the format numbers them, and the widths of its labels.
_TIME_RESPONSE, _TIME = 1, 17
_TYPES = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13}
_LINE, _LABEL = 80, 20


class UffExport(Export):
    """Data sets 58, two for each quantity and DOF: the estimate and its standard deviation.

    The response node is the DOF's number, its direction a scalar. ID line 1 is ``displacement 1`` or ``displacement 1
    std``. Numbers have twelve digits, the time step six, as the format has it; ID line 5 has the step's others.
    """

    name = "uff"

    def check(self) -> None:
        """See :class:`Export`."""
        try:
            import_module("pyuff")
        except ModuleNotFoundError:
            allowed = "a format whose package is installed; uff needs pyuff"
            raise InputError("report.export", self.name, allowed, "pip install 'pinn-cli[uff]'") from None

    def write(self, dataset: xr.Dataset, path: Path) -> None:
        """See :class:`Export`."""
        pyuff: Any = import_module("pyuff")
        time = dataset["time"].values
        si = pyuff.prepare_164(
            units_code=1, units_description="SI: m, N", temp_mode=1, length=1.0, force=1.0, temp=1.0,
            temp_offset=273.15,
        )  # fmt: skip
        sets = [_data_set(pyuff, time, history, kind) for history in histories(dataset) for kind in ("", "std")]
        with replacing(path) as beside:
            pyuff.UFF(str(beside)).write_sets([si, *sets])


def _data_set(pyuff: Any, time: np.ndarray, history: History, kind: str) -> Any:
    title = " ".join(filter(None, (history.quantity, history.dof, kind)))
    step = float(time[-1] - time[0]) / (len(time) - 1)
    return pyuff.prepare_58(
        binary=0, func_type=_TIME_RESPONSE, id1=title[:_LINE], id2="estimated by pinn-run", id3="NONE", id4="NONE",
        id5=f"time step {step:.16g} s", load_case_id=0, rsp_ent_name="NONE", rsp_node=history.number, rsp_dir=0,
        ref_ent_name="NONE", ref_node=0, ref_dir=0, abscissa_spacing=1, abscissa_spec_data_type=_TIME,
        abscissa_axis_units_lab="s", ordinate_spec_data_type=_TYPES[history.quantity],
        ordinate_axis_units_lab=history.unit[:_LABEL], orddenom_spec_data_type=0, z_axis_spec_data_type=0,
        data=np.ascontiguousarray(history.std if kind else history.estimate, dtype=np.float64), x=time,
    )  # fmt: skip
