"""Text as symbols: names of quantities and parameters in plain text, LaTeX and HTML."""

from __future__ import annotations

import re
from html import escape
from typing import Literal

Form = Literal["plain", "latex", "html"]

_QUANTITIES = {
    "displacement": ("u", r"\mathbf{u}"),
    "velocity": ("u̇", r"\dot{\mathbf{u}}"),
    "acceleration": ("ü", r"\ddot{\mathbf{u}}"),
    "force": ("f", r"\mathbf{f}"),
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


def written(text: str, form: Form) -> str:
    """Text for a form: names of quantities and parameters (``k_2/mu_2`` too) as symbols, all else escaped."""
    names = text.split("/")
    if all(name in _QUANTITIES or _PARAMETER.fullmatch(name) for name in names):
        return "/".join(_symbol(name, form) for name in names)
    if form == "latex":
        return "".join(_ACCENTED.get(part, part.translate(_LATEX)) for part in _ACCENTS.split(text))
    return text if form == "plain" else escape(text)


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
