"""Universal files, data sets 58 and 58b (functions at nodal DOFs), by pyuff: time histories by quantity and place."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pinn_cli.record.files.file_format import ArrayFormat
from pinn_cli.record.files.table import SensorHint
from pinn_cli.record.files.variables import Variable
from pinn_cli.settings.errors import InputError

_MARK = b"    -1"
# Function types and data types as the format numbers them.
_GENERAL, _TIME_RESPONSE = 0, 1
_UNKNOWN, _TIME = 0, 17
_FUNCTIONS = {2: "auto spectra", 3: "cross spectra", 4: "frequency response functions", 6: "coherences", 9: "PSDs"}
_QUANTITY_CODES = {8: "displacement", 9: "force", 11: "velocity", 12: "acceleration", 13: "force"}
_DIRECTIONS = ("", "X", "Y", "Z", "RX", "RY", "RZ")
# Units of length and force by the code of data set 164.
_UNIT_CODES = {1: ("m", "N"), 2: ("ft", "lbf"), 5: ("mm", "mN"), 6: ("cm", "cN"), 7: ("in", "lbf"), 10: ("mm", "N")}
_OF_QUANTITY = {"displacement": "{0}", "velocity": "{0}/s", "acceleration": "{0}/s^2", "force": "{1}"}


class UffFormat(ArrayFormat):
    """Time histories ``acceleration 3:+Z``: quantity, node and direction of the response, or by ID line 1.

    A second one of the same name is ``acceleration 3:+Z (2)``. The times are those of the data sets; data sets of
    different rates stand on one clock.
    """

    name = "uff"
    suffixes = (".uff", ".unv", ".uf")
    other_suffixes = (".txt", ".dat", ".asc")
    tells_time = True
    expected = "a universal file (UFF) with data sets 58"
    package = "pyuff"

    def begins(self, content: bytes) -> bool:
        """See :class:`ArrayFormat`."""
        return content.lstrip(b"\r\n").partition(b"\n")[0].rstrip() == _MARK

    def variables(self, path: Path, wanted: Collection[str] | None) -> Mapping[str, Variable]:
        """See :class:`ArrayFormat`."""
        import pyuff

        with path.open("rb") as content:
            if not content.read().rstrip().endswith(_MARK.strip()):
                raise ValueError("its last data set has no end")
        file = pyuff.UFF(str(path))
        numbers = [int(i) for i, kind in enumerate(file.get_set_types()) if int(kind) in (58, 164)]
        sets = [file.read_sets(number) for number in numbers]
        functions = [data_set for data_set in sets if data_set["type"] == 58]
        histories = [data_set for data_set in functions if _is_history(data_set)]
        if not histories:
            others = Counter(_FUNCTIONS.get(data_set["func_type"], "other functions") for data_set in functions)
            counts = ", ".join(f"{count} {kind}" for kind, count in others.items())
            raise InputError("data.path", path, self.expected, f"it has {counts or 'none'}, and no time history")
        code = next((data_set.get("units_code", 0) for data_set in sets if data_set["type"] == 164), 0)
        named: dict[str, Variable] = {}
        labels: dict[str, list[Variable]] = {}
        for data_set in histories:
            plain = " ".join(filter(None, (_quantity(data_set) or "channel", _place(data_set))))
            number = 1 + sum(name == plain or name.startswith(f"{plain} (") for name in named)
            name = plain if number == 1 else f"{plain} ({number})"
            named[name] = _variable(path, name, data_set, code)
            labels.setdefault(data_set["id1"], []).append(named[name])
        return named | {label: of[0] for label, of in labels.items() if len(of) == 1 and label not in named}


def _is_history(data_set: Mapping[str, Any]) -> bool:
    kind, abscissa = data_set["func_type"], data_set["abscissa_spec_data_type"]
    of_time = kind in (_GENERAL, _TIME_RESPONSE) and abscissa in (_UNKNOWN, _TIME)
    return of_time and not np.iscomplexobj(data_set["data"])


def _variable(path: Path, name: str, data_set: Mapping[str, Any], code: int) -> Variable:
    """The samples of a data set, as many as its header tells, at increasing times."""
    count = data_set["num_pts"]
    values = data_set["data"][:count]  # the last block is filled up
    time = np.asarray(data_set["x"][:count], dtype=np.float64)

    def read() -> np.ndarray:
        if len(values) < count:
            raise ValueError(f"{name!r} has {len(values)} of the {count} samples that its header tells")
        if not np.all(np.diff(time) > 0):
            raise InputError("data.path", path, "a file whose times increase", f"those of {name!r} do not")
        return values

    quantity, label = _quantity(data_set), str(data_set.get("ordinate_axis_units_lab", "")).strip()
    unit = "" if label.upper() in ("", "NONE") else label
    if not unit and code in _UNIT_CODES and quantity:
        unit = _OF_QUANTITY[quantity].format(*_UNIT_CODES[code])
    return Variable((len(values), 1), read, hint=SensorHint(unit, quantity, _place(data_set)), time=time)


def _quantity(data_set: Mapping[str, Any]) -> str:
    return _QUANTITY_CODES.get(data_set["ordinate_spec_data_type"], "")


def _place(data_set: Mapping[str, Any]) -> str:
    """Node and direction of the response; "" of a scalar of node 0."""
    node, direction = data_set["rsp_node"], data_set["rsp_dir"]
    if not direction or abs(direction) >= len(_DIRECTIONS):
        return str(node) if node else ""
    return f"{node}:{'+' if direction > 0 else '-'}{_DIRECTIONS[abs(direction)]}"
