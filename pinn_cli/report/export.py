"""The estimated response in files of other programs, beside ``response.nc``: ``report.export=[csv,mat,uff,xlsx]``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import pandas as pd

from pinn_cli.record.response import QUANTITIES
from pinn_cli.runs.workbook import SHEET_ROWS, write_workbook
from pinn_cli.runs.writing import replacing, write_bytes, write_table
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

# Types of functions and data as universal files number them, and the widths of their labels.
_TIME_RESPONSE, _TIME = 1, 17
_TYPES = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13}
_LINE_LENGTH, _LABEL = 80, 20


@dataclass(frozen=True)
class Export:
    """Estimate and standard deviation of every quantity and DOF, in a file named ``response`` and the export's suffix.

    ``name`` is as in ``report.export``; ``write`` writes what `pinn_cli.report.netcdf.response_dataset` makes to a
    file, whole or not at all, by a ``package`` that ``pip install 'pinn-cli[EXTRA]'`` brings.
    """

    name: str
    write: Callable[[xr.Dataset, Path], None]
    package: str = ""
    extra: str = ""


def _dof_names(dataset: xr.Dataset) -> list[str]:
    return [str(name) for name in dataset["dof_name" if "dof_name" in dataset.coords else "dof"].values]


def histories(dataset: xr.Dataset) -> Iterator[tuple[str, str, int, str, xr.DataArray]]:
    """Of every quantity and DOF, its name and its number, the estimate and its ``std``."""
    for quantity in QUANTITIES:
        for i, (dof, number) in enumerate(zip(_dof_names(dataset), dataset["dof"].values, strict=True)):
            yield quantity, dof, int(number), "", dataset[quantity][:, i]
            yield quantity, dof, int(number), "std", dataset[f"{quantity}_std"][:, i]


def _table(dataset: xr.Dataset) -> pd.DataFrame:
    """Columns ``t``, ``displacement_1``, ``displacement_1_std`` and so on, s and SI units."""
    columns = {"_".join(filter(None, (q, dof, std))): history.values for q, dof, _, std, history in histories(dataset)}
    return pd.DataFrame({"t": dataset["time"].values, **columns})


def write_csv(dataset: xr.Dataset, path: Path) -> None:
    """The columns of `_table`, ten significant digits."""
    write_table(_table(dataset), path)


def write_xlsx(dataset: xr.Dataset, path: Path) -> None:
    """The columns of `_table`, a sheet ``response``; what has no place on it goes on in ``response 2`` and so on."""
    table = _table(dataset)
    parts = range(0, len(table), SHEET_ROWS - 1)
    names = [f"response {i}" if i > 1 else "response" for i, _ in enumerate(parts, start=1)]
    write_workbook({name: table.iloc[at : at + SHEET_ROWS - 1] for name, at in zip(names, parts, strict=True)}, path)


def write_mat(dataset: xr.Dataset, path: Path) -> None:
    """Version 5: ``t`` (N × 1, s), ``displacement``, ``displacement_std`` and so on (N × DOFs), ``dof`` (their names).

    ``units`` is a structure with the unit of every quantity.
    """
    from scipy.io import savemat

    content: dict[str, object] = {"t": dataset["time"].values[:, None]}
    content |= {name: dataset[name].values for q in QUANTITIES for name in (q, f"{q}_std")}
    content["dof"] = np.array(_dof_names(dataset), dtype=object)
    content["units"] = {quantity: dataset[quantity].attrs["units"] for quantity in QUANTITIES} | {"t": "s"}
    file = BytesIO()
    savemat(file, content, do_compression=True)
    write_bytes(file.getvalue(), path)


def write_uff(dataset: xr.Dataset, path: Path) -> None:
    """A universal file of data sets 58, two for each quantity and DOF: the estimate and its standard deviation.

    The response node is the DOF's number, its direction a scalar. ID line 1 is ``displacement 1`` or ``displacement 1
    std``. Numbers have twelve digits, the time step six, as the format has it; ID line 5 has the step's others.
    """
    pyuff: Any = import_module("pyuff")
    si = {"units_code": 1, "units_description": "SI: m, N", "length": 1.0, "force": 1.0}
    time = dataset["time"].values
    step = float(time[-1] - time[0]) / (len(time) - 1)
    sets = [pyuff.prepare_164(**si, temp_mode=1, temp=1.0, temp_offset=273.15)]
    for quantity, dof, number, std, history in histories(dataset):
        title = " ".join(filter(None, (quantity, dof, std)))
        data_set = pyuff.prepare_58(
            binary=0, func_type=_TIME_RESPONSE, id1=title[:_LINE_LENGTH], id2="estimated by pinn-run", id3="NONE",
            id4="NONE", id5=f"time step {step:.16g} s", load_case_id=0, rsp_ent_name="NONE", rsp_node=number, rsp_dir=0,
            ref_ent_name="NONE", ref_node=0, ref_dir=0, abscissa_spacing=1, abscissa_spec_data_type=_TIME,
            abscissa_axis_units_lab="s", ordinate_spec_data_type=_TYPES[quantity],
            ordinate_axis_units_lab=history.attrs["units"][:_LABEL], orddenom_spec_data_type=0,
            z_axis_spec_data_type=0, data=np.ascontiguousarray(history.values, dtype=np.float64), x=time,
        )  # fmt: skip
        sets.append(data_set)
    with replacing(path) as temporary:
        pyuff.UFF(str(temporary)).write_sets(sets)


_EXCEL, _UFF = Export("xlsx", write_xlsx, "openpyxl", "excel"), Export("uff", write_uff, "pyuff", "uff")
EXPORTS = {export.name: export for export in (Export("csv", write_csv), Export("mat", write_mat), _UFF, _EXCEL)}


def report_settings(
    export: Sequence[Annotated[str, tuple(EXPORTS)]], between: Sequence[float] | None = None
) -> tuple[tuple[Export, ...], Sequence[float] | None]:
    """What ``report`` says: formats, each once, and from when to when figures show histories, s, not yet checked.

    Raises:
        InputError: ``export`` is no list of names that there are, or one needs a package that is not installed.
    """
    if not isinstance(export, Sequence) or isinstance(export, str) or not all(name in EXPORTS for name in export):
        raise InputError("report.export", export, f"a list of any of {', '.join(EXPORTS)}")
    exports = tuple(EXPORTS[name] for name in dict.fromkeys(export))
    for file_format in (file_format for file_format in exports if file_format.package):
        try:
            import_module(file_format.package)
        except ModuleNotFoundError:
            allowed = f"a format whose package is installed; {file_format.name} needs {file_format.package}"
            raise InputError(
                "report.export", file_format.name, allowed, f"pip install 'pinn-cli[{file_format.extra}]'"
            ) from None
    return exports, between
