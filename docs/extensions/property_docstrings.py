"""Colons in the docstring of a property are colons: napoleon takes what stands before the first one for a type."""

from sphinx.application import Sphinx

STAND_IN = "\ue000"


def hide(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Before napoleon reads the docstring."""
    if what in ("property", "attribute"):
        lines[:] = [line.replace(":", STAND_IN) for line in lines]


def show(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """After it has."""
    lines[:] = [line.replace(STAND_IN, ":") for line in lines]


def setup(app: Sphinx) -> dict[str, bool]:
    """Sphinx calls this; napoleon's priority is 500."""
    app.connect("autodoc-process-docstring", hide, priority=400)
    app.connect("autodoc-process-docstring", show, priority=600)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
