"""When the samples of a file were taken: by a column of times, by its sampling rate, or by the file's own header."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pinn_cli.record.files.table import Table
from pinn_cli.settings.errors import InputError

# Units of a column of times, and how many of them a second has.
TIME_UNITS = {"s": 1.0, "ms": 1e3, "us": 1e6}

# Times are printed with few digits: let each be off the regular axis by this part of a step, or by its last digit.
TIME_TOLERANCE = 0.01
LARGEST_TIME_TOLERANCE = 0.25


@dataclass(frozen=True, eq=False)
class Clock:
    """The times of a table's samples.

    Attributes:
        table: Whose samples they are.
        column: Of the times; "": they come from a sampling rate, a header or several files, s, and need no check.
        readings: (N,), increasing, in ``unit``.
        unit: A key of `TIME_UNITS`.
        several: Whether they are the times of several files: each may be even, and all together not.
    """

    table: Table
    column: str
    readings: np.ndarray
    unit: str = "s"
    several: bool = False

    @classmethod
    def by_column(cls, table: Table, column: str, unit: str) -> Clock:
        """The times that a column has.

        Raises:
            InputError: A time that is missing, or not later than the one before it.
        """
        readings = table.numbers(column)
        table.refuse_gaps(column, readings)
        back = np.flatnonzero(np.diff(readings) <= 0)
        if len(back):
            row = int(back[0]) + 1
            allowed = f"later than the line before it, {readings[row - 1]:.9g}"
            raise InputError(table.place(column, row), readings[row], allowed)
        return cls(table, column, readings, unit)

    @classmethod
    def by_rate(cls, table: Table, sampling_rate: float) -> Clock:
        """Times from 0 on at a sampling rate, Hz."""
        return cls(table, "", np.arange(len(table)) / sampling_rate)

    @property
    def time(self) -> np.ndarray:
        """(N,), s."""
        return self.readings / TIME_UNITS[self.unit]

    def regular(self, first: int, last: int) -> tuple[np.ndarray, bool]:
        """Times of rows first..last (``last`` excluded), s, and whether they are even.

        Even ones are put onto the regular axis between their ends, uneven ones are as they are.

        Raises:
            InputError: Uneven times that the file's own header tells: they are no readings of a clock.
        """
        try:
            return self.uniform(first, last), True
        except InputError:
            if not self.column and not self.several:
                raise
            return self.time[first:last], False

    def step(self, first: int, last: int) -> float:
        """The usual one among rows first..last (``last`` excluded), s."""
        return float(np.median(np.diff(self.time[first:last])))

    def uniform(self, first: int, last: int) -> np.ndarray:
        """Times of rows first..last (``last`` excluded), put onto the regular axis between their ends, s.

        Raises:
            InputError: Times that are off it by more than their printed digits explain; names the line of the jump.
        """
        time = self.readings[first:last]
        regular = np.linspace(time[0], time[-1], len(time))
        step = float(np.median(np.diff(time)))
        tolerance = min(LARGEST_TIME_TOLERANCE * step, max(TIME_TOLERANCE * step, _last_digit(time)))
        if np.max(np.abs(time - regular)) <= tolerance:
            return regular / TIME_UNITS[self.unit]
        deviation = np.abs(np.diff(time) - step)
        jumps = np.flatnonzero(deviation > 2.0 * tolerance)
        row = int(jumps[0] if len(jumps) else np.argmax(deviation)) + 1
        allowed = f"one step of {step:.6g} {self.unit} after the line before it, {time[row - 1]:.9g}"
        hint = "rows are missing, or the file must be resampled to a uniform time axis"
        place = self.table.place(self.column or "its own times", first + row)
        raise InputError(place, time[row], allowed, hint)


def _last_digit(time: np.ndarray) -> float:
    """A unit of the last decimal that the times are printed with; 0 beyond nine decimals."""
    for decimals in range(10):
        if np.allclose(time, np.round(time, decimals), rtol=1e-14, atol=1e-12):
            return float(10.0**-decimals)
    return 0.0
