"""A table as it is read: groups of columns, rows by case and source, cells that may be marked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate
from typing import Literal

Mark = Literal["", "better", "worse"]
DASH = "-"


@dataclass(frozen=True)
class Cell:
    """One value as text, and how it compares with the published one."""

    text: str
    mark: Mark = ""


@dataclass(frozen=True)
class Row:
    """One line of a table.

    Attributes:
        heads: What stands to its left, one text per entry of `Sheet.heads`.
        cells: One per entry of `Sheet.columns`.
        begins: Whether a rule parts it from the row above.
        secondary: Whether it is there for completeness: printed smaller.
    """

    heads: tuple[str, ...]
    cells: tuple[Cell, ...]
    begins: bool = False
    secondary: bool = False


@dataclass(frozen=True)
class Sheet:
    """A table of the paper with its values and ours.

    Attributes:
        name: Of its files.
        title: One line.
        note: What the reader must know of its numbers, one paragraph.
        heads: Titles of the columns at the left.
        groups: Title and number of columns of each group, in order; together all of ``columns``.
        columns: A quantity (``displacement``), a parameter (``k_2``) or plain text.
        rows: In order.

    Raises:
        ValueError: Columns that do not fit the groups, or a row that does not fit the columns.
    """

    name: str
    title: str
    note: str
    heads: tuple[str, ...]
    groups: tuple[tuple[str, int], ...]
    columns: tuple[str, ...]
    rows: tuple[Row, ...]

    def __post_init__(self) -> None:
        if sum(span for _, span in self.groups) != len(self.columns):
            raise ValueError(f"{self.name}: the groups span other than {len(self.columns)} columns")
        for row in self.rows:
            if len(row.heads) != len(self.heads) or len(row.cells) != len(self.columns):
                raise ValueError(f"{self.name}: row {row.heads} does not fit the columns")

    @property
    def grouped(self) -> bool:
        """Whether any group has a title."""
        return any(title for title, _ in self.groups)

    @property
    def spans(self) -> list[tuple[str, int, int]]:
        """Each group's title, first column and last column, counted from 1."""
        ends = list(accumulate(span for _, span in self.groups))
        return [(title, end - span + 1, end) for (title, span), end in zip(self.groups, ends, strict=True)]


def number(value: float, pattern: str, mark: Mark = "") -> Cell:
    """A number as `format` writes it; a dash, never marked, where it is unknown."""
    return Cell(format(value, pattern), mark) if math.isfinite(value) else Cell(DASH)


def mark(ours: float, published: float, more_is_better: bool = False) -> Mark:
    """How a value compares, at the two decimals that the paper prints; no mark where either is unknown."""
    gain = (round(ours, 2) - round(published, 2)) * (1.0 if more_is_better else -1.0)
    return "better" if gain > 0.0 else "worse" if gain < 0.0 else ""
