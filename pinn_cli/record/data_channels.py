"""What every channel of a measured record is: ``data.channels``, the long form behind ``data.acceleration={1: a1}``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pinn_cli.record.channel import Calibration, Channel, unknown_calibration
from pinn_cli.record.own_sensor import as_channel
from pinn_cli.record.units import si_factor
from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.legal_values import entries, finite_number, is_finite_number, is_whole_number, one_of
from pinn_cli.system.quantities import (
    CALIBRATION_UNITS,
    CONNECTION_FORCE,
    FORCE,
    GROUND,
    HIGH_PASS,
    MOTION,
    SUPPORT,
    TILT,
)

SENSORS = (*MOTION, FORCE, GROUND, CONNECTION_FORCE)
OF_MOTION = ("dof", "between", "weights", "support")
PLACES = (*OF_MOTION, "connection")
KEYS = ("sensor", "column", "unit", *PLACES, *CALIBRATION_UNITS)
# What data.channels may say (`pinn-run --json-schema`): entries with these keys, or those of a class of the user's own.
_SENSOR: dict[str, Any] = {"anyOf": [{"enum": [*SENSORS]}, {"type": "string", "pattern": r"\$\{"}]}
_PARTS: dict[str, Any] = {**{key: {} for key in KEYS}, "sensor": _SENSOR}
_ENTRY = {"anyOf": [{"required": ["_target_"]}, {"properties": _PARTS, "additionalProperties": False}]}
CHANNELS: dict[str, Any] = {"type": "object", "additionalProperties": {"type": "object", **_ENTRY}}
UNKNOWN = "unknown"
# Of a channel before its samples are read.
NOTHING = np.zeros(0)
# Sensors that may have a number of a calibration, where not all may.
FELT_BY = {TILT: ("acceleration",), HIGH_PASS: ("acceleration", "velocity", GROUND)}


@dataclass(frozen=True)
class DataChannel:
    """One channel of a file.

    Attributes:
        setting: Where the user gives it.
        column: Of the file.
        sensor: What it is, without samples; offset and drift are in the file's unit, an unknown number is NaN.
        connection: Name or number of the connection whose force it measures.
        factor: SI units that one of its units is; None: of the unit that the file's header tells, or SI units.
    """

    setting: str
    column: str
    sensor: Channel
    connection: str | int | None = None
    factor: float | None = None

    @classmethod
    def of_column(cls, setting: str, column: str, quantity: str, dof: int | None = None) -> DataChannel:
        """Of the short form; the DOF is counted from 1, None: of the ground."""
        weights = {} if dof is None else {dof - 1: 1.0}
        return cls(setting, column, Channel(column, quantity, weights, NOTHING, NOTHING))

    @property
    def is_plain(self) -> bool:
        """Whether its samples, calibrated as is known, are what the structure does at their times."""
        return self.sensor.is_column and all(
            given.is_known and (given.value == 0.0 or kind not in ("delay", TILT, HIGH_PASS))
            for kind, given in self.sensor.calibration.items()
        )

    def in_unit(self, header: str) -> DataChannel:
        """The same with its unit settled: what the user gives, else what the file's header tells, else SI.

        A unit of the header that pint cannot read, or one of another quantity, is refused.
        """
        if self.factor is not None:
            return self
        if not header:
            return replace(self, factor=1.0)
        quantity = self.sensor.quantity
        try:
            return replace(self, factor=si_factor(self.setting, header, SUPPORT.get(quantity, quantity)))
        except InputError as error:
            allowed = f"a channel whose unit is known: give data.channels.{self.sensor.key}.unit"
            raise InputError(self.setting, repr(self.column), allowed, f"its header says {header!r}") from error

    def with_samples(self, time: np.ndarray, values: np.ndarray, connections: Sequence[str], fills: bool) -> Channel:
        """The channel in SI units, with samples (J,) as the file has them at times (J,), s.

        It fills its column where its DOF has no other sensor of the kind; connections are the names of the structure's.
        A connection that does not exist is refused, and a delay longer than the record.
        """
        assert self.factor is not None
        given = self.sensor.calibration
        shown, unknown = self.factor * values, {kind for kind, number in given.items() if number.unknown}
        calibration = {
            kind: unknown_calibration(kind, time, shown, both={"offset", "drift"} <= unknown)
            if number.unknown
            else number.times(self.factor if kind in ("offset", "drift") else 1.0)
            for kind, number in given.items()
        }
        late, duration = calibration.get("delay", Calibration(0.0)), float(time[-1] - time[0])
        if abs(late.value) >= duration:
            allowed = f"shorter than the record, {duration:.6g} s"
            raise InputError(f"{self.setting}.delay", late.value, allowed, "delays are in s")
        connection = -1 if self.connection is None else self._connection(connections)
        samples: dict[str, Any] = {"time": time, "measured": shown, "calibration": calibration}
        return replace(self.sensor, **samples, connection=connection, fills=fills)

    def _connection(self, connections: Sequence[str]) -> int:
        if self.connection in connections:
            return connections.index(str(self.connection))
        numbers = range(1, len(connections) + 1)
        if is_whole_number(self.connection) and self.connection in numbers:
            return int(self.connection) - 1  # type: ignore[arg-type]
        allowed, hint = f"a connection: {', '.join(connections)}", suggestion(str(self.connection), connections)
        raise InputError(f"{self.setting}.connection", self.connection, allowed, hint)


def data_channels(given: Any) -> tuple[DataChannel, ...]:
    """``data.channels`` as channels, DOFs as numbers from 1; what it cannot mean is refused. Channels stay."""
    if given is None:
        return ()
    if isinstance(given, tuple) and all(isinstance(channel, DataChannel) for channel in given):
        return given
    if not isinstance(given, Mapping):
        raise InputError("data.channels", given, "a map of channel: {sensor: ..., dof: ...}")
    return tuple(_channel(str(name), node) for name, node in given.items())


def _channel(name: str, node: Any) -> DataChannel:
    setting = f"data.channels.{name}"
    if not isinstance(node, Mapping):
        raise InputError(setting, node, "a map such as {sensor: acceleration, dof: 1, unit: g}")
    node = as_channel(setting, node)
    for key in node:
        if key not in KEYS:
            allowed = f"one of the keys {', '.join(KEYS)}"
            raise InputError(f"{setting}.{key}", node[key], allowed, suggestion(str(key), KEYS))
    sensor = one_of(f"{setting}.sensor", node.get("sensor"), SENSORS)
    column = name if node.get("column") is None else node["column"]
    if not isinstance(column, str) or not column:
        raise InputError(f"{setting}.column", column, "the name of a column")
    where = _where(setting, sensor, node)
    factor = None if node.get("unit") is None else si_factor(f"{setting}.unit", node["unit"], sensor)
    given = {kind: node[kind] for kind in CALIBRATION_UNITS if node.get(kind) is not None}
    order = 0
    if HIGH_PASS in given:
        given[HIGH_PASS], order = _filter(f"{setting}.{HIGH_PASS}", given[HIGH_PASS])
    for kind, sensors in FELT_BY.items():
        if kind in given and sensor not in sensors:
            raise InputError(f"{setting}.{kind}", given[kind], f"left out: it is of {' or '.join(sensors)}")
    calibration = {kind: _number(f"{setting}.{kind}", kind, value) for kind, value in given.items()}
    weights = where.get("weights", {})
    if "support" in where:
        weights, sensor = {where["support"]: 1.0}, f"support_{sensor}"
        for kind, number in calibration.items():
            if not number.is_known or kind not in ("gain", "offset", "drift"):
                allowed = "left out, or a known gain, offset or drift of a support"
                raise InputError(f"{setting}.{kind}", given[kind], allowed)
    channel = Channel(name, sensor, weights, NOTHING, NOTHING, calibration, filter_order=order)
    return DataChannel(setting, column, channel, where.get("connection"), factor)


def _filter(setting: str, given: Any) -> tuple[Any, int]:
    """Corner of a high-pass filter as given, and its order."""
    if not isinstance(given, Mapping) or "frequency" not in given:
        return given, 1
    order = given.get("order", 1)
    if set(given) - {"frequency", "order"} or isinstance(order, bool) or order not in (1, 2):
        raise InputError(setting, dict(given), "a corner in Hz, or {frequency: 0.5, order: 1 or 2}")
    return given["frequency"], int(order)


def _where(setting: str, sensor: str, node: Mapping[str, Any]) -> dict[str, Any]:
    """Weights of DOFs, counted from 0, the connection of a channel, or its support."""
    given = {key: node[key] for key in PLACES if node.get(key) is not None}
    wanted = {GROUND: (), CONNECTION_FORCE: ("connection",), FORCE: ("dof",)}.get(sensor, OF_MOTION)
    if len(given) != min(len(wanted), 1) or not set(given) <= set(wanted):
        shown = "{" + ", ".join(f"{key}: {place}" for key, place in given.items()) + "}"
        allowed = f"one of {', '.join(wanted)}" if wanted else "no dof, between, weights or connection"
        raise InputError(setting, shown, f"{allowed} with sensor: {sensor}")
    for key, place in given.items():
        setting = f"{setting}.{key}"
        if key == "connection":
            return {key: place}
        if key == "support":
            return {key: _dof(setting, place)}
        if key == "dof":
            return {"weights": {_dof(setting, place): 1.0}}
        return {"weights": (_between if key == "between" else _weighted)(setting, place)}
    return {"weights": {}}


def _between(setting: str, place: Any) -> dict[int, float]:
    """Weights of a sensor that feels u_a - u_b."""
    ends = ["ground" if end == 0 else end for end in entries(place)]
    if len(ends) != 2 or ends[0] == ends[1]:
        raise InputError(setting, place, "two DOFs [a, b]: the sensor feels u_a - u_b, and ground is 0")
    return {_dof(setting, end): sign for end, sign in zip(ends, (1.0, -1.0), strict=True) if end != "ground"}


def _weighted(setting: str, place: Any) -> dict[int, float]:
    """Weights of a sensor that feels any sum."""
    if not isinstance(place, Mapping) or not place:
        raise InputError(setting, place, "a map of DOF: weight, such as {1: 0.4, 2: -0.2}")
    weights = {_dof(setting, key): float(finite_number(f"{setting}.{key}", weight)) for key, weight in place.items()}
    if len(weights) < len(place) or not all(weights.values()):
        raise InputError(setting, dict(place), "weights other than 0, one of each DOF that it feels")
    return weights


def _dof(setting: str, dof: Any) -> int:
    """A DOF, counted from 1 or as text, counted from 0."""
    number = int(dof) if isinstance(dof, str) and dof.isdecimal() else dof
    if not is_whole_number(number) or number < 1:
        raise InputError(setting, dof, "a DOF, counted from 1")
    return int(number) - 1


def _number(setting: str, kind: str, given: Any) -> Calibration:
    """One number of a calibration: known, ``unknown``, or value and uncertainty."""
    if given == UNKNOWN:
        return Calibration(math.nan, unknown=True)
    both = given if isinstance(given, Mapping) else {"value": given, "uncertainty": 0.0}
    if set(both) != {"value", "uncertainty"} or not all(map(is_finite_number, both.values())):
        raise InputError(setting, given, "a number, unknown, or {value: ..., uncertainty: ...}")
    value, std = float(both["value"]), float(both["uncertainty"])
    if std < 0.0:
        raise InputError(f"{setting}.uncertainty", std, ">= 0: a standard deviation")
    if kind == HIGH_PASS and value <= 0.0:
        raise InputError(setting, given, "a corner > 0 Hz", "a sensor that passes slow motion has none")
    if kind == "gain" and value == 0.0:
        raise InputError(setting, given, "a gain that is not 0", "a sensor that shows nothing is no sensor")
    return Calibration(value, std)
