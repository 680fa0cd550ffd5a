"""What `run`, `inspect` and `modes` are given as data, as settings: what each column is, by its name."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from pinn_cli.runs.resume import named_directory
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import quoted, setting_of

if TYPE_CHECKING:
    import numpy as np

    from pinn_cli.record.files.table import Table
    from pinn_cli.record.record import Record

# As `pinn_cli.system.quantities` has them; not from there, so that errors about words come at once.
_OF_DOFS = ("force", "displacement", "velocity", "acceleration")
_GROUND = "ground_acceleration"
# What says itself which column is what; names then say nothing.
_NAMED_COLUMNS = tuple(f"data.{name}" for name in (*_OF_DOFS, _GROUND, "channels", "records"))
_CLOCKS = ("data.time", "data.sampling_rate")
# force.1, acceleration_3, velocity 2; a DOF's name after a point only: acceleration.roof.
_CHANNEL = re.compile(rf"({'|'.join(_OF_DOFS)})(?:[._ ]?(\d+)|\.(\w+))")


def refuse_nameless(names: Collection[str]) -> None:
    """Refuse columns none of which says what it is.

    Raises:
        InputError: Always.
    """
    from pinn_cli.record.files.table import listed

    hint = "or say what is what: \"data.acceleration={1: 'a1'}\""
    raise InputError("data", listed(names), "columns such as force.1, acceleration.3", hint)


@contextmanager
def settings_of(
    data: Any, overrides: Sequence[str], nameless: Callable[[Collection[str]], None] = refuse_nameless
) -> Iterator[list[str]]:
    """The settings that have a run read some data, which is there for it within the block.

    Args:
        data: See :func:`pinn_cli.run`; None: there is none.
        overrides: Given beside it.
        nameless: Called with the names of columns none of which says what it is.

    Raises:
        InputError: Naming `data`: it is no data, no column says what it is, or a setting says that it lies in a file.
    """
    if data is None:
        yield []
        return
    from pinn_cli.api.sep005 import is_sep005, table_of_sep005
    from pinn_cli.record.files.frame import held, named_by_content, table_of
    from pinn_cli.record.record import Record

    for override in overrides:
        name = setting_of(override)
        if name in ("data", "data.path", "data.format", "data.kind"):
            hint = "the record is in memory"
            raise InputError(name, override.partition("=")[2], "left out with data=..., the argument", hint)
    several = isinstance(data, list | tuple) and not is_sep005(data)
    given = list(data) if several else [data]
    if not given:
        raise InputError("data", "[]", "a frame, or a list of frames, one for each record")
    with ExitStack() as stack:
        entries = []
        for number, item in enumerate(given, start=1):
            columns, of_record, acting = settings_of_record(item) if isinstance(item, Record) else (item, {}, [])
            name = f"data[{number}]" if several else "data"
            table = named_by_content(table_of_sep005(item, name)) if is_sep005(item) else table_of(columns, name)
            stack.enter_context(held(table))
            settings = _settings(table, of_record)
            if not any(f"{setting_of(o)}.".startswith(f"{channel}.") for o in overrides for channel in _NAMED_COLUMNS):
                channels = channels_of(table)
                if not channels:
                    nameless(table.columns)
                settings |= _written_channels(channels, acting)
            if any(setting_of(override) in _CLOCKS for override in overrides):
                settings.pop("time", None)
            entries.append(settings)
        if named_directory(overrides):  # it goes on with the settings that it has
            yield []
        elif several:
            yield ["data=frame", f"data.records=[{', '.join(map(_written, entries))}]"]
        else:
            yield ["data=frame", *(f"data.{name}={value}" for name, value in entries[0].items())]


def settings_of_record(given: Record) -> tuple[dict[str, np.ndarray], dict[str, str], list[str]]:
    """A record as columns by the names that `run` knows.

    Returns:
        The columns, what else the record says as settings of `data`, and DOFs whose force nobody measured.

    Raises:
        InputError: It has sensors that are no columns.
    """
    from pinn_cli.record.measured_data import UNMEASURED
    from pinn_cli.record.response import QUANTITIES

    if given.calibrated:
        shown = f"a record with the sensors {', '.join(channel.key for channel in given.calibrated)}"
        raise InputError("data", shown, "one whose sensors are columns", "give a frame")
    names = [given.dof_name(dof) for dof in range(given.ndof)]
    columns: dict[str, np.ndarray] = {"t": given.time}
    for quantity in QUANTITIES:
        for dof in given.sensors(quantity).nonzero()[0]:
            columns[f"{quantity}.{names[dof]}"] = getattr(given, quantity)[:, dof]
    settings: dict[str, str] = {"intersample": given.intersample}
    if given.ground_acceleration is not None:
        settings["frame"] = given.frame
        if given.measured_ground is None:
            settings[_GROUND] = UNMEASURED
        else:
            columns[_GROUND] = given.measured_ground
    acting = (~given.unforced & ~given.sensors("force")).nonzero()[0]
    return columns, settings, [names[dof] for dof in acting]


def _settings(table: Table, of_record: dict[str, str]) -> dict[str, str]:
    """Name within `data` to value, as an override writes it, but for channels."""
    from pinn_cli.record.files.table import column_of_times

    times = column_of_times(table.columns)
    return {"path": quoted(table.path.name), **of_record, **({"time": quoted(times)} if times in table.columns else {})}


def _written(settings: dict[str, str]) -> str:
    """A map as an override writes it."""
    return f"{{{', '.join(f'{name}: {value}' for name, value in settings.items())}}}"


def channels_of(table: Table) -> dict[str, dict[str, str]]:
    """Quantity to DOF to column, of the columns whose names say both; of the ground the DOF is "".

    Where a header says what all others measure, their DOFs are the numbers in their names.

    Raises:
        InputError: Two columns say the same.
    """
    from pinn_cli.record.files.table import SensorHint, bare, is_called_times
    from pinn_cli.record.signal import number_in

    said: list[tuple[str, str, str]] = [(_GROUND, "", name) for name in table.columns if bare(name) == _GROUND][:1]
    matches = {name: _CHANNEL.fullmatch(bare(name)) for name in table.columns}
    said += [(match[1], match[2] or match[3], name) for name, match in matches.items() if match]
    rest = [n for n in table.columns if n not in [name for _, _, name in said] and not is_called_times(n)]
    guesses = [(table.hints.get(name, SensorHint()).quantity, number_in(name), name) for name in rest]
    if all(quantity and number for quantity, number, _ in guesses):
        said += [(quantity, str(number), name) for quantity, number, name in guesses]
    maps: dict[str, dict[str, str]] = {}
    for quantity, place, name in said:
        dof = str(int(place)) if place.isdecimal() else place
        if dof in maps.setdefault(quantity, {}):
            hint = "a DOF with two sensors of a kind takes data.channels"
            raise InputError("data", repr(name), f"the only column of data.{quantity}.{dof}", hint)
        maps[quantity][dof] = name
    return maps


def _written_channels(maps: dict[str, dict[str, str]], acting: Sequence[str]) -> dict[str, str]:
    """As overrides write them, with the DOFs whose force nobody measured."""
    of_dofs = {q: {dof: quoted(name) for dof, name in columns.items()} for q, columns in maps.items() if q != _GROUND}
    if acting:
        of_dofs.setdefault("force", {}).update(dict.fromkeys(acting, "null"))
    written = {quantity: _written(columns) for quantity, columns in of_dofs.items()}
    return written | {quantity: quoted(columns[""]) for quantity, columns in maps.items() if quantity == _GROUND}
