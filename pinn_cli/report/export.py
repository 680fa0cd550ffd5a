"""The estimated response in files of other programs, beside ``response.nc``: ``report.export=[csv,mat,uff]``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd

from pinn_cli.record.response import QUANTITIES
from pinn_cli.runs.writing import replacing, write_bytes, write_table
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

# Types of functions and data as universal files number them, and the widths of their labels.
_TIME_RESPONSE, _TIME = 1, 17
_TYPES = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13}
_LINE, _LABEL = 80, 20


class Export(ABC):
    """Estimate and standard deviation of every quantity and DOF, in a file named ``response`` and the export's suffix.

    Attributes:
        name: As in ``report.export``.
    """

    name: ClassVar[str]

    def check(self) -> None:  # noqa: B027  # most need nothing
        """Refuse what this machine cannot write, before anything is estimated.

        Raises:
            InputError: A package is not installed.
        """

    @abstractmethod
    def write(self, dataset: xr.Dataset, path: Path) -> None:
        """Write the file, whole or not at all.

        Args:
            dataset: As `pinn_cli.report.dataset.response_dataset` makes it.
            path: Of the file.
        """


@dataclass(frozen=True, eq=False)
class DofHistory:
    """One quantity of one DOF.

    Attributes:
        quantity: displacement, velocity, acceleration or force.
        number: Of the DOF, from 1.
        dof: Its name, or its number as text.
        unit: SI.
        estimate, std: (N,).
    """

    quantity: str
    number: int
    dof: str
    unit: str
    estimate: np.ndarray
    std: np.ndarray


def histories(dataset: xr.Dataset) -> Iterator[DofHistory]:
    """Every quantity, DOF by DOF."""
    numbers = dataset["dof"].values
    names = dataset["dof_name"].values if "dof_name" in dataset.coords else numbers
    for quantity in QUANTITIES:
        estimate, std = dataset[quantity], dataset[f"{quantity}_std"].values
        unit = str(estimate.attrs["units"])
        for i, (number, name) in enumerate(zip(numbers, names, strict=True)):
            yield DofHistory(quantity, int(number), str(name), unit, estimate.values[:, i], std[:, i])


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
            content |= {name: dataset[name].values for name in (quantity, f"{quantity}_std")}
        content["dof"] = np.array(list(dict.fromkeys(history.dof for history in every)), dtype=object)
        content["units"] = {history.quantity: history.unit for history in every} | {"t": "s"}
        file = BytesIO()
        savemat(file, content, do_compression=True)
        write_bytes(file.getvalue(), path)


class UffExport(Export):
    """A universal file: data sets 58, two for each quantity and DOF: the estimate and its standard deviation.

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


def _data_set(pyuff: Any, time: np.ndarray, history: DofHistory, kind: str) -> Any:
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


EXPORTS: dict[str, type[Export]] = {export.name: export for export in (CsvExport, MatExport, UffExport)}


def exports_of(names: Any) -> tuple[Export, ...]:
    """Those that ``report.export`` names, in its order, each once.

    Raises:
        InputError: It is no list of names that there are, or one needs a package that is not installed.
    """
    if not isinstance(names, Sequence) or isinstance(names, str) or not all(name in EXPORTS for name in names):
        raise InputError("report.export", names, f"a list of any of {', '.join(EXPORTS)}")
    exports = tuple(EXPORTS[name]() for name in dict.fromkeys(names))
    for export in exports:
        export.check()
    return exports
