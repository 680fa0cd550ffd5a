"""Tables as Markdown and LaTeX and the report as HTML, from the files in ``templates/``."""

from __future__ import annotations

import base64
import mimetypes
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pinn_cli.paper.symbols import Form, written
from pinn_cli.runs.writing import write_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.paper.sheet import Sheet

SIGNS = {"better": "▲", "worse": "▼"}
LATEX_MARKS = {"": "%s", "better": r"\textbf{%s}", "worse": r"\underline{%s}"}


def write_sheets(sheets: Sequence[Sheet], directory: Path) -> None:
    """Write each as ``<name>.md`` and ``<name>.tex``."""
    for sheet in sheets:
        write_text(markdown(sheet), directory / f"{sheet.name}.md")
        write_text(latex(sheet), directory / f"{sheet.name}.tex")


def markdown(sheet: Sheet) -> str:
    """A Markdown table."""
    return render("table.md", sheet=sheet)


def latex(sheet: Sheet) -> str:
    r"""A ``table*`` for ``\input``; the document needs ``\usepackage{booktabs,graphicx}``."""
    return render("table.tex", sheet=sheet)


def render(name: str, **content: object) -> str:
    """The template ``<name>.j2`` with its content filled in; in HTML all text is escaped."""
    return _environment().get_template(f"{name}.j2").render(content)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("pinn_cli.paper"), trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined,
        autoescape=lambda name: bool(name and name.endswith(".html.j2")),
    )  # fmt: skip
    environment.filters |= {"symbols": _symbols, "data_uri": _data_uri}
    environment.globals |= {"signs": SIGNS, "marks": LATEX_MARKS}
    return environment


def _symbols(text: str, form: Form) -> str:
    return Markup(written(text, form)) if form == "html" else written(text, form)


def _data_uri(image: Path) -> str:
    return f"data:{mimetypes.guess_type(image.name)[0]};base64,{base64.b64encode(image.read_bytes()).decode('ascii')}"
