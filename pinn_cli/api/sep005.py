"""Time series as other packages of structural dynamics exchange them: SEP 5 of SDyPy, a map for each channel.

Keys that are read: ``name``, ``data`` (samples, or channels x samples), ``unit_str``; ``fs`` (Hz) or ``time`` (s);
``quantity`` (``a``, ``v``, ``d``, ``f``), ``start_timestamp``. See https://sdypy.readthedocs.io, SEP 5.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pinn_cli.record.files.table import TIME_COLUMN, SensorHint, Table, check_names
from pinn_cli.record.files.variables import joined
from pinn_cli.record.signal import quantity_of_unit
from pinn_cli.report.export import histories
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import positive_number

if TYPE_CHECKING:
    import xarray as xr

SEP005_QUANTITIES = {"d": "displacement", "v": "velocity", "a": "acceleration", "f": "force"}
_COMPULSORY = ("name", "data", "unit_str")


def is_sep005(given: Any) -> bool:
    """Whether it is a time series, or a list of them."""
    series = given if isinstance(given, list | tuple) and given else [given]
    return all(isinstance(entry, Mapping) and {"data", "unit_str"} <= set(entry) for entry in series)


def table_of_sep005(given: Any, setting: str) -> Table:
    """Columns by the names of the channels, and the times ``t``, s; NaN where another channel alone has a sample.

    Args:
        given: See :func:`is_sep005`.
        setting: What it is called in errors.

    Raises:
        InputError: A key is missing or has a value that is none of it; clocks do not overlap; a name is there twice.
    """
    series = given if isinstance(given, list | tuple) else [given]
    tables: list[Table] = []
    for entry, time in zip(series, _times(series, setting), strict=True):
        columns = _columns(entry, f"{setting}[{entry.get('name')!r}]", len(time))
        unit, code = str(entry["unit_str"] or ""), str(entry.get("quantity") or "")
        quantity = SEP005_QUANTITIES.get(code) or quantity_of_unit(SensorHint(unit).unit)
        hints = {name: SensorHint(unit, quantity) for name in columns}
        tables.append(Table(Path(setting), columns, hints=hints, time=time))
    names = [name for table in tables for name in table.columns]
    if twice := [name for i, name in enumerate(names) if name in (TIME_COLUMN, *names[:i])]:
        raise InputError(setting, repr(twice[0]), f"channels with different names, none of them {TIME_COLUMN}")
    first = tables[0].time
    if all(np.array_equal(first, table.time) for table in tables):  # type: ignore[arg-type]
        columns = {name: values for table in tables for name, values in table.columns.items()}
        hints = {name: hint for table in tables for name, hint in table.hints.items()}
        table = Table(Path(setting), columns, hints=hints, time=first)
    else:
        table = joined(tables, [table.time for table in tables if table.time is not None])
    assert table.time is not None
    columns = {TIME_COLUMN: table.time, **table.columns}
    return Table(table.path, columns, {name: {} for name in columns}, table.hints)


def placed(table: Table, dofs: Mapping[str, int]) -> Table:
    """Some channels of :func:`table_of_sep005` by the names that say what they measure, at which DOF, and no others.

    Raises:
        InputError: There is no such channel, or it is not said what it measures.
    """
    check_names(table.path, {f"dofs[{name!r}]": name for name in dofs}, table.columns)
    names = {}
    for name, dof in dofs.items():
        quantity = table.hints[name].quantity
        if not quantity:
            raise InputError(f"{table.path}[{name!r}], quantity", None, f"one of {', '.join(SEP005_QUANTITIES)}")
        names[name] = f"{quantity}.{dof}"
    columns = {TIME_COLUMN: table.columns[TIME_COLUMN], **{names[name]: table.columns[name] for name in names}}
    return Table(table.path, columns, hints={names[name]: table.hints[name] for name in names})


def _times(series: Sequence[Mapping[str, Any]], setting: str) -> list[np.ndarray]:
    """(N,) of every series, s; from the earliest start on where all say when they begin."""
    times, starts = [], []
    for entry in series:
        place = f"{setting}[{entry.get('name')!r}]"
        for key in _COMPULSORY:
            if entry.get(key) is None:
                raise InputError(f"{place}, {key}", entry.get(key), "given", "SEP 5 of SDyPy asks for it")
        samples = np.shape(entry["data"])[-1] if np.ndim(entry["data"]) else 0
        if entry.get("time") is not None:
            time = _numbers(entry["time"], f"{place}, time")
        elif entry.get("fs") is not None:
            time = np.arange(samples) / positive_number(f"{place}, fs", entry["fs"])
        else:
            raise InputError(f"{place}, fs", None, "given, in Hz, or time, in s")
        if time.shape != (samples,) or not np.isfinite(time).all() or not (np.diff(time) > 0.0).all():
            allowed = f"{samples} times that grow, one for each sample"
            raise InputError(f"{place}, time", f"an array of shape {time.shape}", allowed)
        times.append(time)
        if (start := entry.get("start_timestamp")) is not None:
            try:  # a time without a zone counts as that of this machine
                moment = start if isinstance(start, datetime) else datetime.fromisoformat(str(start))
            except ValueError:
                allowed = "a date as ISO 8601 writes it, 2026-03-01T12:00:00"
                raise InputError(f"{place}, start_timestamp", start, allowed) from None
            starts.append(moment.timestamp())
    if len(starts) < len(times):
        return times
    return [time + (start - min(starts)) for time, start in zip(times, starts, strict=True)]


def _columns(entry: Mapping[str, Any], setting: str, samples: int) -> dict[str, np.ndarray]:
    values, name = _numbers(entry["data"], f"{setting}, data"), str(entry["name"])
    if values.ndim not in (1, 2) or samples == 0:
        allowed = "samples of one channel, or (channels, samples)"
        raise InputError(f"{setting}, data", f"an array of shape {values.shape}", allowed)
    return {name: values} if values.ndim == 1 else {f"{name}.{i}": row for i, row in enumerate(values, start=1)}


def _numbers(given: Any, setting: str) -> np.ndarray:
    try:
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(setting, type(given).__name__, "an array of numbers") from None


def response_as_sep005(response: xr.Dataset) -> list[dict[str, Any]]:
    """Of :attr:`pinn_cli.Result.response` every history and its deviation, groups ``estimate`` and ``std``."""
    time = response["time"].values
    common = {"fs": float((len(time) - 1) / (time[-1] - time[0])), "time": time.tolist()}
    codes = {quantity: code for code, quantity in SEP005_QUANTITIES.items()}
    return [
        {
            "name": f"{quantity}.{dof}{f' {std}' if std else ''}", "data": np.array(history.values, dtype=np.float64),
            "unit_str": history.attrs["units"].replace("^2", "\N{SUPERSCRIPT TWO}"), "quantity": codes[quantity],
            "group": std or "estimate", **common,
        }
        for quantity, dof, _, std, history in histories(response)
    ]  # fmt: skip
