"""Data that the identified system is tried on and no estimator sees (``data.validation``)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.record import MINIMUM_SAMPLES, Record
from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.legal_values import finite_number

# Settings of ``data`` that another record cannot have of its own.
NOT_ITS_OWN = ("base", "kind", "format", "holdout", "validation", "responds")
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
        of: Which of several records of the estimator that is, counted from 0; its sensors' calibrations hold.
    """

    record: Record
    first: int
    begins: int | None
    of: int = 0


@dataclass(frozen=True)
class ValidationData:
    """A record of its own, or a segment of the file that the estimator sees another part of.

    Attributes:
        data: Its file, columns and window.
        seen: What the estimator sees, record by record, without the segment.
        of: The record that it goes on from, or else has its settings from.
        follows: Whether it is a later segment of that one's file, so that the estimate tells how it begins.
        settle: Seconds at its start that are simulated and not compared.
    """

    data: MeasuredData
    seen: tuple[MeasuredData, ...]
    of: int
    follows: bool
    settle: float

    @classmethod
    def among(cls, measured: Sequence[Any]) -> ValidationData | None:
        """From ``data.validation``; None where there is none, or of objects that have no such setting.

        Args:
            measured: What a data option built, record by record of the estimator; all have that setting. What it does
                not say is as in the one whose file it is a segment of, or else as in the first.

        Raises:
            InputError: Naming ``data.validation.<setting>``; or the estimator sees the segment as well.
        """
        records = [record for record in measured if isinstance(record, MeasuredData)]
        if len(records) < len(measured) or (given := records[0].validation) is None:
            return None
        settings = [setting.name for setting in fields(MeasuredData) if setting.name not in NOT_ITS_OWN]
        if not isinstance(given, Mapping) or not given:
            allowed = "null, a segment {start: ..., stop: ...}, or another record {path: ...}"
            raise InputError("data.validation", given, allowed)
        for name in given:
            if name not in (*settings, SETTLE):
                allowed = f"one of the settings {', '.join((*settings, SETTLE))}"
                raise InputError(f"data.validation.{name}", given[name], allowed, suggestion(str(name), settings))
        settle = finite_number(f"data.validation.{SETTLE}", given.get(SETTLE, 0.0))
        if settle < 0.0:
            raise InputError(f"data.validation.{SETTLE}", settle, ">= 0 s")
        segment = {name: value for name, value in given.items() if name != SETTLE}
        if "path" not in segment and any(record.path != records[0].path for record in records):
            hint = "the records of data.records are of different files"
            raise InputError("data.validation.path", None, "the file that it is a segment of, or another one", hint)
        path = segment.get("path", records[0].path)
        same = [number for number, record in enumerate(records) if record.path == path]
        of = same[0] if same else 0
        window = {"start": None, "stop": None} | segment
        with_window = replace(records[of], **(window | {"holdout": (), "validation": None}))
        cut = [_seen(record, with_window) if record.path == path else (record, False) for record in records]
        seen = tuple(replace(record, validation=None) for record, _ in cut)
        before = [number for number, (_, follows) in enumerate(cut) if follows]
        if before:
            of = max(before, key=lambda number: seen[number].stop or -math.inf)
        return cls(with_window, seen, of, bool(before), float(settle))

    def read(self, records: Sequence[Record], ndof: int, connections: Sequence[str] = ()) -> ValidationRecord:
        """The record that the identified system is tried on.

        Raises:
            InputError: As of :meth:`MeasuredData.measure`; a force that nobody measured; nothing left to compare.
        """
        seen = records[self.of]
        begins = max(0, len(seen.time) - 1 - len(seen.time) // LEAD_SHARE) if self.follows else None
        data = self.data
        if begins is not None:
            data = replace(data, start=float(seen.time[begins]) - 1e-6 * seen.step)
        try:
            record = data.measure(ndof, connections).record
        except InputError as error:
            setting = re.sub(r"\bdata\.", "data.validation.", error.setting)
            raise InputError(setting, error.value, error.allowed, error.hint) from error
        if record.unmeasured:
            hint = f"{record.unmeasured} is unknown, and what is simulated needs all that acts"
            raise InputError("data.validation", "a record", "one whose forces are all measured", hint)
        compared = record.time[0] if self.data.start is None else self.data.start
        first = int(np.searchsorted(record.time, compared + self.settle - 1e-6 * record.step))
        if len(record.time) - first < MINIMUM_SAMPLES:
            hint = f"{max(0, len(record.time) - first)} samples are left to compare"
            raise InputError(f"data.validation.{SETTLE}", self.settle, f"leaving {MINIMUM_SAMPLES} samples", hint)
        return ValidationRecord(record, first, begins, self.of)


def _seen(data: MeasuredData, segment: MeasuredData) -> tuple[MeasuredData, bool]:
    """What is left for the estimator of a file that a segment is taken out of, and whether the segment follows it.

    Where the user says nothing of the window that the estimator sees, it ends where the segment begins; of a segment
    from the file's start on, it begins where that ends.
    """
    start, stop = (math.inf * sign if x is None else x for sign, x in ((-1, segment.start), (1, segment.stop)))
    seen_start, seen_stop = (math.inf * sign if x is None else x for sign, x in ((-1, data.start), (1, data.stop)))
    if seen_stop < start:
        return data, True
    if seen_start > stop:
        return data, False
    if segment.start is not None and data.stop is None and seen_start < start:
        return replace(data, stop=math.nextafter(start, -math.inf)), True
    if segment.start is None and data.start is None and stop < seen_stop:
        return replace(data, start=math.nextafter(stop, math.inf)), False
    given = f"{segment.start}, {segment.stop}"
    allowed = f"outside of what the estimator sees, data.start={data.start} to data.stop={data.stop}"
    hint = "a segment that the estimator has seen says nothing; give data.start and data.stop"
    raise InputError("data.validation.start, data.validation.stop", given, allowed, hint)
