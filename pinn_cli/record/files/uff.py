"""Universal files, data sets 58 and 58b (functions at nodal DOFs), by pyuff: time histories by quantity and place."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pinn_cli.record.files.base import FileFormat
from pinn_cli.record.files.joined import joined
from pinn_cli.record.files.on_disk import damaged, other_format, read_bytes
from pinn_cli.record.files.table import SensorHint, Table, check_names, same_length
from pinn_cli.settings.errors import InputError

_EXPECTED = "a universal file (UFF) with data sets 58"
_MARK = b"    -1"
# Function types and data types as the format numbers them.
_GENERAL, _TIME_RESPONSE = 0, 1
_UNKNOWN, _TIME = 0, 17
_FUNCTIONS = {2: "auto spectra", 3: "cross spectra", 4: "frequency response functions", 6: "coherences", 9: "PSDs"}
_QUANTITIES = {8: "displacement", 9: "force", 11: "velocity", 12: "acceleration", 13: "force"}
_DIRECTIONS = ("", "X", "Y", "Z", "RX", "RY", "RZ")
# Units of length and force by the code of data set 164.
_UNITS = {1: ("m", "N"), 2: ("ft", "lbf"), 5: ("mm", "mN"), 6: ("cm", "cN"), 7: ("in", "lbf"), 10: ("mm", "N")}
_OF_QUANTITY = {"displacement": "{0}", "velocity": "{0}/s", "acceleration": "{0}/s^2", "force": "{1}"}


class UffFormat(FileFormat):
    """Time histories ``acceleration 3:+Z``: quantity, node and direction of the response, or by ID line 1.

    A second one of the same name is ``acceleration 3:+Z (2)``. The times are those of the data sets; data sets of
    different rates stand on one clock.
    """

    name = "uff"
    suffixes = (".uff", ".unv", ".uf")
    other_suffixes = (".txt", ".dat", ".asc")
    tells_time = True

    def read(self, path: Path, wanted: Mapping[str, str] | None = None) -> Table:
        """See :class:`FileFormat`."""
        content = read_bytes(path)
        first = content.lstrip(b"\r\n").partition(b"\n")[0].rstrip()
        if first != _MARK:
            raise other_format(path, content[:512], _EXPECTED)
        if not content.rstrip().endswith(_MARK.strip()):
            raise damaged(path, _EXPECTED, ValueError("its last data set has no end"))
        pyuff = self.package("pyuff")
        try:
            sets = _read(pyuff.UFF(str(path)))
        except Exception as error:  # pyuff raises plain Exceptions
            raise damaged(path, _EXPECTED, error) from None
        return _table(path, sets, wanted)


def _read(file: Any) -> list[dict[str, Any]]:
    """Data sets 58, and 164 with the units."""
    numbers = [int(i) for i, kind in enumerate(file.get_set_types()) if int(kind) in (58, 164)]
    sets = [file.read_sets(number) for number in numbers]
    for one in sets:
        if one["type"] == 58:  # what follows the samples fills the last line or the last block
            one["x"], one["data"] = one["x"][: one["num_pts"]], one["data"][: one["num_pts"]]
    return sets


def _table(path: Path, sets: Sequence[Mapping[str, Any]], wanted: Mapping[str, str] | None) -> Table:
    functions = [one for one in sets if one["type"] == 58]
    histories = [one for one in functions if _is_history(one)]
    if not histories:
        others = Counter(_FUNCTIONS.get(one["func_type"], "other functions") for one in functions)
        found = ", ".join(f"{count} {kind}" for kind, count in others.items())
        raise InputError("data.path", path, _EXPECTED, f"it has {found or 'none'}, and no time history")
    code = next((one.get("units_code", 0) for one in sets if one["type"] == 164), 0)
    named = _named(histories)
    if wanted is None:
        names = list(named)
    else:
        labels = _labels(histories, named)
        check_names(path, wanted, named.keys() | labels.keys() if labels.keys() & set(wanted.values()) else named)
        named = {**labels, **named}
        names = list(dict.fromkeys(wanted.values()))
    for name in names:
        _check_whole(path, name, named[name])
    clocks: dict[bytes, list[str]] = {}
    for name in names:
        clocks.setdefault(_time(named[name]).tobytes(), []).append(name)
    tables = [
        Table(path, {name: np.asarray(named[name]["data"], dtype=np.float64) for name in group},
              hints={name: _hint(named[name], code) for name in group}, time=_time(named[group[0]]))
        for group in clocks.values()
    ]  # fmt: skip
    for table in tables:
        same_length(path, table.columns)
    return tables[0] if len(tables) == 1 else joined(tables, [t.time for t in tables if t.time is not None])


def _is_history(one: Mapping[str, Any]) -> bool:
    of_time = one["func_type"] in (_GENERAL, _TIME_RESPONSE) and one["abscissa_spec_data_type"] in (_UNKNOWN, _TIME)
    return of_time and not np.iscomplexobj(one["data"])


def _check_whole(path: Path, name: str, one: Mapping[str, Any]) -> None:
    """The data set has the samples that its header tells, at increasing times."""
    found, told = len(one["data"]), one["num_pts"]
    if found < told:
        raise damaged(path, _EXPECTED, ValueError(f"{name!r} has {found} of the {told} samples that its header tells"))
    step = one["abscissa_inc"]
    if one["abscissa_spacing"] == 1 and not (math.isfinite(step) and step > 0):
        raise InputError("data.path", path, "a file whose samples have a step in time", f"that of {name!r} is {step}")
    if not np.all(np.diff(_time(one)) > 0):
        raise InputError("data.path", path, "a file whose times increase", f"those of {name!r} do not")


def _time(one: Mapping[str, Any]) -> np.ndarray:
    return np.asarray(one["x"], dtype=np.float64)


def _named(histories: Sequence[Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    named: dict[str, Mapping[str, Any]] = {}
    for one in histories:
        plain = " ".join(filter(None, (_quantity(one) or "channel", _place(one))))
        number = 1 + sum(name == plain or name.startswith(f"{plain} (") for name in named)
        named[plain if number == 1 else f"{plain} ({number})"] = one
    return named


def _labels(histories: Sequence[Mapping[str, Any]], named: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Histories by their first ID line, where one alone has it."""
    counts = Counter(one["id1"] for one in histories)
    return {one["id1"]: one for one in histories if counts[one["id1"]] == 1 and one["id1"] not in named}


def _quantity(one: Mapping[str, Any]) -> str:
    return _QUANTITIES.get(one["ordinate_spec_data_type"], "")


def _place(one: Mapping[str, Any]) -> str:
    """Node and direction of the response; "" of a scalar of node 0."""
    node, direction = one["rsp_node"], one["rsp_dir"]
    if not direction or abs(direction) >= len(_DIRECTIONS):
        return str(node) if node else ""
    return f"{node}:{'+' if direction > 0 else '-'}{_DIRECTIONS[abs(direction)]}"


def _hint(one: Mapping[str, Any], code: int) -> SensorHint:
    quantity, label = _quantity(one), str(one.get("ordinate_axis_units_lab", "")).strip()
    unit = "" if label.upper() in ("", "NONE") else label
    if not unit and code in _UNITS and quantity:
        unit = _OF_QUANTITY[quantity].format(*_UNITS[code])
    return SensorHint(unit, quantity, _place(one))
