"""A table as it is read, with its symbols, and its forms: Markdown, LaTeX and, in reports, HTML; pages of these."""

from __future__ import annotations

import base64
import math
import mimetypes
import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from itertools import accumulate
from pathlib import Path
from typing import Any, Literal, NamedTuple

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pinn_cli.runs.reading import printable
from pinn_cli.runs.writing import write_text

Mark = Literal["", "better", "worse"]
Form = Literal["plain", "latex", "html"]

TEMPLATES = "pinn_cli.report"
DASH = "-"
ARROWS = {"better": "▲", "worse": "▼"}
LATEX_MARKS = {"": "%s", "better": r"\textbf{%s}", "worse": r"\underline{%s}"}
_QUANTITIES = {
    "displacement": ("u", r"\mathbf{u}"),
    "velocity": ("u̇", r"\dot{\mathbf{u}}"),
    "acceleration": ("ü", r"\ddot{\mathbf{u}}"),
    "force": ("f", r"\mathbf{f}"),
}
_PARAMETER = re.compile(r"(m|c|k|kappa|mu)_(\d+)")
_GREEK = {"kappa": "κ", "mu": "μ"}
# Letters with a combining accent are two characters.
_LATEX = {
    "x̃": r"$\tilde{x}$", "x̄": r"$\bar{x}$",
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "−": "$-$", "κ": r"$\kappa$", "μ": r"$\mu$",
    "–": "--", "±": r"$\pm$", "²": "$^2$", "³": "$^3$", "‖": r"$\|$", "·": r"$\cdot$",
}  # fmt: skip
_SPECIAL = re.compile("|".join(map(re.escape, _LATEX)))


class Cell(NamedTuple):
    """One value as text, and how it compares with the published one."""

    text: str = DASH
    mark: Mark = ""

    @classmethod
    def number(cls, value: float, pattern: str, mark: Mark = "") -> Cell:
        """A number as `format` writes it; a dash, never marked, where it is unknown."""
        return cls(format(value, pattern), mark) if math.isfinite(value) else cls()


class Row(NamedTuple):
    """One line of a table: texts to its left, and cells; a rule may part it from the row above, or it is small."""

    heads: tuple[str, ...]
    cells: tuple[Cell, ...]
    begins: bool = False
    secondary: bool = False


def block(head: str, cells: Mapping[str, Mapping[Any, Cell]], columns: Sequence[Hashable]) -> list[Row]:
    """A row for each source of values, its cells by column; the first begins a block, those called printed are small.

    What a source has no cell for is a dash.
    """
    return [
        Row(
            ("" if i else head, source), tuple(row.get(c, Cell()) for c in columns), not i, source.endswith(", printed")
        )
        for i, (source, row) in enumerate(cells.items())
    ]


def mark(ours: float, published: float, more_is_better: bool = False) -> Mark:
    """How a value compares, at the two decimals that the paper prints; no mark where either is unknown."""
    gain = (round(ours, 2) - round(published, 2)) * (1.0 if more_is_better else -1.0)
    return "better" if gain > 0.0 else "worse" if gain < 0.0 else ""


@dataclass(frozen=True)
class Sheet:
    """A table with heads at its left and groups of columns, such as one of the paper with its values and ours.

    Attributes:
        name: Of its files.
        title: One line.
        note: What the reader must know of its numbers, one paragraph.
        heads: Titles of the columns at the left.
        groups: Title of each group of columns and these: quantities (``displacement``), parameters (``k_2``) or text.
        rows: In order.
    """

    name: str
    title: str
    note: str
    heads: tuple[str, ...]
    groups: Sequence[tuple[str, Sequence[str]]]
    rows: Sequence[Row]

    @property
    def columns(self) -> tuple[str, ...]:
        """Of all groups."""
        return tuple(column for _, columns in self.groups for column in columns)

    @property
    def spans(self) -> list[tuple[str, int, int]]:
        """Each group's title, first column and last column, counted from 1."""
        ends = accumulate(len(columns) for _, columns in self.groups)
        return [(title, end - len(columns) + 1, end) for (title, columns), end in zip(self.groups, ends, strict=True)]

    @property
    def markdown(self) -> str:
        """As a table of Markdown."""
        return render("table.md", sheet=self)

    @property
    def latex(self) -> str:
        r"""A ``table*`` for ``\input``; the document needs ``\usepackage{booktabs,graphicx}``."""
        return render("table.tex", sheet=self)

    def write(self, directory: Path) -> None:
        """Write ``<name>.md`` and ``<name>.tex``."""
        write_text(self.markdown, directory / f"{self.name}.md")
        write_text(self.latex, directory / f"{self.name}.tex")


def render(name: str, package: str = TEMPLATES, **content: object) -> str:
    """The template ``<name>.j2`` of a package with its content filled in; in HTML all text is escaped."""
    return _environment(package).get_template(f"{name}.j2").render(content)


@cache
def _environment(package: str) -> Environment:
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader(TEMPLATES)]), trim_blocks=True, lstrip_blocks=True,
        undefined=StrictUndefined,
        # Names of channels and of files may be anything.
        finalize=lambda value: printable(value) if type(value) is str else value,
        autoescape=lambda name: bool(name and name.endswith(".html.j2")),
    )  # fmt: skip
    environment.filters |= {"symbols": written, "data_uri": _data_uri}
    environment.globals |= {"signs": ARROWS, "marks": LATEX_MARKS}
    return environment


def _data_uri(image: Path) -> str:
    return f"data:{mimetypes.guess_type(image.name)[0]};base64,{base64.b64encode(image.read_bytes()).decode('ascii')}"


def written(text: str, form: Form) -> str:
    """Text for a form: names of quantities and parameters (``k_2/mu_2`` too) as symbols, all else escaped."""
    text = printable(text)
    names = text.split("/")
    if all(name in _QUANTITIES or _PARAMETER.fullmatch(name) for name in names):
        text = "/".join(_symbol(name, form) for name in names)
    elif form == "latex":
        text = _SPECIAL.sub(lambda found: _LATEX[found[0]], text)
    elif form == "html":
        text = escape(text)
    return Markup(text) if form == "html" else text


def _symbol(name: str, form: Form) -> str:
    if name in _QUANTITIES:
        plain, latex = _QUANTITIES[name]
        return {"plain": plain, "latex": f"${latex}$", "html": f"<i>{plain}</i>"}[form]
    kind, _, connection = name.rpartition("_")
    letter, command = _GREEK.get(kind, kind), rf"\{kind}" if kind in _GREEK else kind
    return {
        "plain": f"{letter}_{connection}",
        "latex": f"${command}_{{{connection}}}$",
        "html": f"<i>{letter}</i><sub>{connection}</sub>",
    }[form]
