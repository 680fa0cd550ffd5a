"""A table as it is read: groups of columns, rows by case and source, cells that may be marked."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from itertools import accumulate
from typing import Literal

Mark = Literal["", "better", "worse"]
Form = Literal["plain", "latex", "html"]

DASH = "-"

_QUANTITIES = {
    "displacement": {"plain": "u", "latex": r"$\mathbf{u}$", "html": "<i>u</i>"},
    "velocity": {"plain": "u̇", "latex": r"$\dot{\mathbf{u}}$", "html": "<i>u̇</i>"},
    "acceleration": {"plain": "ü", "latex": r"$\ddot{\mathbf{u}}$", "html": "<i>ü</i>"},
    "force": {"plain": "f", "latex": r"$\mathbf{f}$", "html": "<i>f</i>"},
}
_PARAMETER = re.compile(r"(m|c|k|kappa|mu)_(\d+)")
_GREEK = {"kappa": "κ", "mu": "μ"}
_LATEX = str.maketrans(
    {"\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
     "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "−": "$-$", "κ": r"$\kappa$", "μ": r"$\mu$",
     "–": "--", "±": r"$\pm$", "²": "$^2$", "³": "$^3$", "‖": r"$\|$", "·": r"$\cdot$"}
)  # fmt: skip
# Letters with a combining accent are two characters, which a translation by character cannot see.
_ACCENTED = {"x̃": r"$\tilde{x}$", "x̄": r"$\bar{x}$"}
_ACCENTS = re.compile(f"({'|'.join(_ACCENTED)})")
_HTML = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;"})


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


def written(text: str, form: Form) -> str:
    """Text for a form: names of quantities and parameters (``k_2/mu_2`` too) as symbols, all else escaped."""
    names = text.split("/")
    if all(name in _QUANTITIES or _PARAMETER.fullmatch(name) for name in names):
        return "/".join(_symbol(name, form) for name in names)
    if form == "latex":
        return "".join(_ACCENTED.get(part, part.translate(_LATEX)) for part in _ACCENTS.split(text))
    return text if form == "plain" else text.translate(_HTML)


def _symbol(name: str, form: Form) -> str:
    if name in _QUANTITIES:
        return _QUANTITIES[name][form]
    kind, _, connection = name.rpartition("_")
    if form == "latex":
        return rf"${f'{chr(92)}{kind}' if kind in _GREEK else kind}_{{{connection}}}$"
    letter = _GREEK.get(kind, kind)
    return f"{letter}_{connection}" if form == "plain" else f"<i>{letter}</i><sub>{connection}</sub>"
