"""Variables of a file as columns: vectors by their name, a matrix's columns by its name and their number."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pinn_cli.record.files.on_disk import check_size
from pinn_cli.record.files.table import SensorHint, Table, check_names, same_length
from pinn_cli.settings.errors import InputError


@dataclass(frozen=True, eq=False)
class Variable:
    """An array in a file, which may not have been read yet.

    Attributes:
        shape: As the program that wrote it shows it.
        load: Its numbers, float64, of that shape.
        content: What it holds instead of real numbers, such as ``text``; "": it holds real numbers.
        unit: As the file writes it.
    """

    shape: tuple[int, ...]
    load: Callable[[], np.ndarray]
    content: str = ""
    unit: str = ""

    @classmethod
    def of(cls, array: np.ndarray, unit: str = "") -> Variable:
        """Of an array that has been read, of whatever type."""
        return cls(array.shape, lambda: as_float(array), content_of(array.dtype), unit)

    @property
    def sides(self) -> tuple[int, ...]:
        """Lengths of the sides that are longer than 1."""
        return tuple(side for side in self.shape if side != 1)

    @property
    def columns(self) -> int:
        """How many columns it has: 1 of a vector, 0 of a scalar or of what is neither vector nor matrix."""
        if self.content or 0 in self.shape or len(self.sides) not in (1, 2):
            return 0
        return 1 if len(self.sides) == 1 else min(self.sides)

    @property
    def samples(self) -> int:
        """Length of each of them: of a matrix its longer side, which is time's."""
        return max(self.sides, default=0)

    def read(self) -> np.ndarray:
        """(samples, columns)."""
        array = self.load().reshape(self.sides)
        if array.ndim == 1:
            return array[:, None]
        return array if array.shape[0] >= array.shape[1] else array.T


def table_of(
    path: Path, variables: Mapping[str, Variable], wanted: Mapping[str, str] | None, time: np.ndarray | None = None
) -> Table:
    """The columns that are asked for; without any, those of the length that most variables have.

    Column j, from 1, of the matrix ``acc`` is ``acc.1``, ``acc.2`` and so on.

    Args:
        path: Of the file.
        variables: By name.
        wanted: Setting to name of a column; None: all.
        time: Of the samples, where the file tells it.

    Raises:
        InputError: Naming the setting: there is no such variable, or it is no vector of numbers; or the columns differ
            in length.
    """
    names = _wanted_of(variables) if wanted is None else list(dict.fromkeys(wanted.values()))
    if wanted is not None:
        for setting, name in wanted.items():
            _check(path, setting, name, variables)
    places = {name: _place(name, variables) for name in names}
    roots = {root for root, _ in places.values()}
    check_size(path, sum(8 * variables[root].samples * variables[root].columns for root in roots))
    arrays = {root: variables[root].read() for root in roots}
    columns = {name: np.ascontiguousarray(arrays[root][:, j]) for name, (root, j) in places.items()}
    same_length(path, columns)
    hints = {name: SensorHint(variables[root].unit) for name, (root, _) in places.items() if variables[root].unit}
    return Table(path, columns, hints=hints, time=time)


def content_of(dtype: np.dtype) -> str:
    """What arrays of a type hold; "" of real numbers."""
    kinds = {"b": "true or false", "c": "complex numbers", "S": "text", "U": "text", "M": "dates", "m": "durations"}
    return "" if dtype.kind in "iuf" else kinds.get(dtype.kind, "text or objects")


def as_float(array: np.ndarray) -> np.ndarray:
    """The same numbers as float64, in native byte order."""
    return np.asarray(array).astype(np.float64)


def _names(variables: Mapping[str, Variable]) -> list[str]:
    """Every column by name."""
    return [column for name, variable in variables.items() for column in _columns_of(name, variable)]


def _columns_of(name: str, variable: Variable) -> list[str]:
    count = variable.columns
    return [name] if count == 1 else [f"{name}.{j}" for j in range(1, count + 1)]


def _wanted_of(variables: Mapping[str, Variable]) -> list[str]:
    lengths = Counter(v.samples for v in variables.values() for _ in range(v.columns))
    usual = max(lengths, key=lambda length: (lengths[length], length), default=0)
    return _names({name: variable for name, variable in variables.items() if variable.samples == usual})


def _place(name: str, variables: Mapping[str, Variable]) -> tuple[str, int]:
    """Variable and column, from 0, of a name that `_check` has found good."""
    if name in variables:
        return name, 0
    root, _, number = name.rpartition(".")
    return root, int(number) - 1


def _check(path: Path, setting: str, name: str, variables: Mapping[str, Variable]) -> None:
    known = _names(variables)
    if name in known:
        return
    root, _, number = name.rpartition(".")
    variable = variables.get(name)
    if variable is None and root in variables and number.isdecimal():
        found = f"{root} has {variables[root].columns} columns of numbers, counted from 1"
        raise InputError(setting, repr(name), f"a column of {path.name}", found)
    if variable is None:
        check_names(path, {setting: name}, known, _fields(name, variables))
        return
    raise InputError(setting, repr(name), "a vector of numbers, or a column of a matrix", _why(path, name, variable))


def _why(path: Path, name: str, variable: Variable) -> str:
    """Why a variable is no column."""
    shape = " × ".join(map(str, variable.shape)) or "1 × 1"
    if variable.content:
        return f"in {path.name} it holds {variable.content}, which pinn-run does not evaluate"
    if 0 in variable.shape:
        return f"in {path.name} it is empty, {shape}"
    if not variable.sides:
        return f"in {path.name} it is a single number"
    if len(variable.sides) > 2:
        return f"in {path.name} it is {shape}, neither vector nor matrix"
    long, few = variable.samples, variable.columns
    return f"in {path.name} it is {shape}: {name}.1 to {name}.{few} are its {few} channels of {long} samples"


def _fields(name: str, variables: Iterable[str]) -> str:
    """A hint where the name is that of a structure or a group."""
    within = [other for other in variables if other.startswith((f"{name}.", f"{name}/"))]
    return f"{name} is a structure: name one of its fields, such as {within[0]}" if within else ""
