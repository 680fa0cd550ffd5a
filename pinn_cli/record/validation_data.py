"""Data that the identified system is tried on and no estimator sees (``data.validation``)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.record import MINIMUM_SAMPLES, Record
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import finite_number
from pinn_cli.settings.suggestion import suggestion

# Settings of ``data`` that another record cannot have of its own.
FIXED = ("base", "kind", "format", "holdout", "validation", "responds")
SETTLE = "settle"
# One over the share of the estimator's record before its end at which its state is taken: at the very end the ends of
# splines show.
LEAD_SHARE = 32


@dataclass(frozen=True, eq=False)
class ValidationRecord:
    """What the identified system is tried on.

    Attributes:
        record: With every sensor that it has.
        first: Sample from which on it is compared.
        begins: Sample of the estimator's record whose estimated state it begins with; None: at rest.
    """

    record: Record
    first: int
    begins: int | None


@dataclass(frozen=True)
class ValidationData:
    """A record of its own, or a segment of the file that the estimator sees another part of.

    Attributes:
        data: Its file, columns and window.
        seen: What the estimator sees, without the segment.
        follows: Whether it is a later segment of the same file, so that the estimate tells how it begins.
        settle: Seconds at its start that are simulated and not compared.
    """

    data: MeasuredData
    seen: MeasuredData
    follows: bool
    settle: float

    @classmethod
    def of(cls, data: MeasuredData) -> ValidationData | None:
        """From ``data.validation``; None where there is none.

        Raises:
            InputError: Naming ``data.validation.<setting>``; or the estimator sees the segment as well.
        """
        given = data.validation
        if given is None:
            return None
        known = [each.name for each in fields(MeasuredData) if each.name not in FIXED]
        if not isinstance(given, Mapping) or not given:
            allowed = "null, a segment {start: ..., stop: ...}, or another record {path: ...}"
            raise InputError("data.validation", given, allowed)
        for name in given:
            if name not in (*known, SETTLE):
                allowed = f"one of the settings {', '.join((*known, SETTLE))}"
                raise InputError(f"data.validation.{name}", given[name], allowed, suggestion(str(name), known))
        settle = finite_number(f"data.validation.{SETTLE}", given.get(SETTLE, 0.0))
        if settle < 0.0:
            raise InputError(f"data.validation.{SETTLE}", settle, ">= 0 s")
        own = {name: value for name, value in given.items() if name != SETTLE}
        same = own.get("path", data.path) == data.path
        window = {"start": None, "stop": None} | own
        with_window = replace(data, **(window | {"holdout": (), "validation": None}))
        seen, follows = _seen(data, with_window) if same else (data, False)
        return cls(with_window, replace(seen, validation=None), follows, float(settle))

    def read(self, seen: Record, ndof: int, connections: Sequence[str] = ()) -> ValidationRecord:
        """The record that the identified system is tried on.

        Args:
            seen: What the estimator sees.
            ndof: DOFs of the structure.
            connections: Names of its connections.

        Raises:
            InputError: As of :meth:`MeasuredData.measure`; a force that nobody measured; nothing left to compare.
        """
        begins = max(0, len(seen.time) - 1 - len(seen.time) // LEAD_SHARE) if self.follows else None
        data = self.data
        if begins is not None:
            data = replace(data, start=float(seen.time[begins]) - 1e-6 * seen.step)
        try:
            record = data.measure(ndof, connections).record
        except InputError as error:
            raise InputError(_own_setting(error.setting), error.value, error.allowed, error.hint) from error
        unknown = np.flatnonzero(np.isnan(record.force).any(axis=0))
        if unknown.size:
            hint = f"that on {record.dof_names(unknown)} is unknown, and what is simulated needs every force"
            raise InputError("data.validation", "a record", "one whose forces are all measured", hint)
        compared = record.time[0] if self.data.start is None else self.data.start
        first = int(np.searchsorted(record.time, compared + self.settle - 1e-6 * record.step))
        if len(record.time) - first < MINIMUM_SAMPLES:
            hint = f"{max(0, len(record.time) - first)} samples are left to compare"
            raise InputError(f"data.validation.{SETTLE}", self.settle, f"leaving {MINIMUM_SAMPLES} samples", hint)
        return ValidationRecord(record, first, begins)


def _seen(data: MeasuredData, segment: MeasuredData) -> tuple[MeasuredData, bool]:
    """What is left for the estimator of a file that a segment is taken out of, and whether the segment follows it.

    Where the user says nothing of the window that the estimator sees, it ends where the segment begins; of a segment
    from the file's start on, it begins where that ends.
    """
    start, stop = (math.inf * sign if x is None else x for sign, x in ((-1, segment.start), (1, segment.stop)))
    own_start, own_stop = (math.inf * sign if x is None else x for sign, x in ((-1, data.start), (1, data.stop)))
    if own_stop < start:
        return data, True
    if own_start > stop:
        return data, False
    if segment.start is not None and data.stop is None and own_start < start:
        return replace(data, stop=math.nextafter(start, -math.inf)), True
    if segment.start is None and data.start is None and stop < own_stop:
        return replace(data, start=math.nextafter(stop, math.inf)), False
    given = f"{segment.start}, {segment.stop}"
    allowed = f"outside of what the estimator sees, data.start={data.start} to data.stop={data.stop}"
    hint = "a segment that the estimator has seen says nothing; give data.start and data.stop"
    raise InputError("data.validation.start, data.validation.stop", given, allowed, hint)


def _own_setting(setting: str) -> str:
    return ", ".join(
        f"data.validation.{name.removeprefix('data.')}" if name.startswith("data.") else name
        for name in setting.split(", ")
    )


def validation_of(given: Any) -> ValidationData | None:
    """Of an object that a data option built; None of one that has no such setting."""
    return ValidationData.of(given) if isinstance(given, MeasuredData) else None
