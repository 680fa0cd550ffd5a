"""Columns of a printed table, and numbers as they are printed in them."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

WIDTH = 100
MARK = "! "


@dataclass(frozen=True)
class Column:
    """A column of a printed table.

    Attributes:
        title: Its heading.
        width: Characters; negative where it is flush left.
        text: From a cell's value to what is printed.
    """

    title: str
    width: int
    text: Callable[[Any], str]

    def align(self, text: str) -> str:
        """The text in a cell of this width."""
        return f"{text:>{self.width}}" if self.width > 0 else f"{text:<{-self.width}}"


def table_lines(columns: Mapping[str, Column], table: pd.DataFrame) -> list[str]:
    """The headings, a rule, and a line per row of the table, with the columns named."""
    head = "".join(column.align(column.title) for column in columns.values())
    rows = [
        "".join(column.align(column.text(row[name])) for name, column in columns.items()).rstrip()
        for row in table.to_dict(orient="records")
    ]
    return [head, "-" * len(head), *rows]


def marked_lines(sentence: str) -> list[str]:
    """A warning, wrapped, with `MARK` before its first line."""
    return textwrap.wrap(sentence, WIDTH, initial_indent=MARK, subsequent_indent=" " * len(MARK))


def number(value: float, digits: int = 5) -> str:
    """A number with ``digits`` significant digits, and an exponent only where it would be long without one."""
    if not np.isfinite(value):
        return "-"
    order = math.floor(math.log10(abs(value))) if value else 0
    return f"{value:.{max(digits - 1 - order, 0)}f}" if -5 < order < 7 else f"{value:.{digits - 1}e}"


def count(value: float) -> str:
    """A whole number; a dash where there is none."""
    return f"{value:.0f}" if np.isfinite(value) else "-"


def percent(value: float) -> str:
    """A fitness or an error in per cent, short also where it is far off; a dash where there is none."""
    return "-" if not np.isfinite(value) else f"{value:.2f}" if abs(value) < 1e4 else f"{value:.0e}"


def interval(lower: float, upper: float) -> str:
    """Both ends; a dash where there are none."""
    return f"{number(lower)} to {number(upper)}" if np.isfinite(lower) and np.isfinite(upper) else "-"
