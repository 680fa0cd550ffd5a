"""One look for all figures: the paper's page, a palette that the colour-blind can read, and how a figure becomes files.

Figures are made through matplotlib's object-oriented interface, never through ``pyplot``: no global state, no window,
and no backend to choose.
"""

from __future__ import annotations

import re
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from pinn_cli.record.response import UNITS
from pinn_cli.runs.writing import replacing

if TYPE_CHECKING:
    from collections.abc import Iterator

PAGE_WIDTH = 7.2  # inch, the two columns of a journal's page

# Okabe and Ito's palette (2008), distinct under every common colour vision deficiency.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILLION, PURPLE, GREY = "#F0E442", "#0072B2", "#D55E00", "#CC79A7", "#7F7F7F"
CYCLE = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK)

DOTS: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 4.0, "markeredgewidth": 0}

SYMBOLS = {
    "displacement": r"$u$",
    "velocity": r"$\dot{u}$",
    "acceleration": r"$\ddot{u}$",
    "force": r"$f$",
    "ground_acceleration": r"$\ddot{u}_g$",
    "connection_force": r"$r$",
    "support_displacement": r"$s$",
    "support_velocity": r"$\dot{s}$",
    "support_acceleration": r"$\ddot{s}$",
}

_STYLE: dict[Any, Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 8,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "axes.edgecolor": "#404040",
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "lines.linewidth": 0.9,
    "lines.markersize": 3,
    "grid.linewidth": 0.4,
    "grid.color": "#D9D9D9",
    "axes.titley": 1.0,  # a fixed place: looking for what a title might collide with takes a third of the drawing time
    "axes.formatter.limits": (-6, 7),  # prefixes of units do what offsets do
    "axes.formatter.useoffset": False,
    "path.simplify": True,
    "pdf.fonttype": 42,  # journals refuse Type 3 fonts
    "savefig.dpi": 150,
}


@contextmanager
def look() -> Iterator[None]:
    """The look of this package's figures, for the length of a block; matplotlib's own settings are back afterwards."""
    with mpl.rc_context(_STYLE):
        yield


def panels(
    rows: int,
    columns: int,
    height: float,
    *,
    width: float = PAGE_WIDTH,
    margins: tuple[float, float, float, float],
    gaps: tuple[float, float],
    **options: Any,
) -> tuple[Figure, np.ndarray]:
    """A figure with a grid of panels; fixed margins take a tenth of the time of a layout that is computed.

    Args:
        rows: Number of them.
        columns: Number of them.
        height: Of a panel, inch.
        width: Of the figure, inch.
        margins: Left, right, top, bottom, inch.
        gaps: Between neighbours, across and down, inch.
        options: Of `matplotlib.figure.Figure.subplots`, ``gridspec_kw`` apart.

    Returns:
        The figure, and its panels (rows, columns).
    """
    left, right, top, bottom = margins
    total = top + rows * height + (rows - 1) * gaps[1] + bottom
    panel = (width - left - right - (columns - 1) * gaps[0]) / columns
    figure = Figure(figsize=(width, total))
    places = {"left": left / width, "right": 1.0 - right / width, "top": 1.0 - top / total, "bottom": bottom / total}
    grid = places | {"wspace": gaps[0] / panel, "hspace": gaps[1] / height}
    return figure, np.asarray(figure.subplots(rows, columns, squeeze=False, gridspec_kw=grid, **options))


def save(figure: Figure, directory: Path | str, name: str) -> list[Path]:
    """Write ``figure`` as ``name.png`` (150 dpi) and ``name.pdf`` under ``directory``.

    The same figure gives the same bytes.
    """
    _place_empty_labels(figure)
    written = []
    # Creation dates and versions would make two equal runs differ.
    kinds: dict[str, dict[str, Any]] = {
        # Half the time of the usual level, a sixth more bytes.
        ".png": {"metadata": {"Software": None}, "pil_kwargs": {"compress_level": 3}},
        ".pdf": {"metadata": {"CreationDate": None, "Producer": None}},
    }
    for suffix, options in kinds.items():
        place = Path(directory) / f"{name}{suffix}"
        with look(), replacing(place) as beside:
            figure.savefig(beside, format=suffix[1:], **options)
        written.append(place)
    return written


def _place_empty_labels(figure: Figure) -> None:
    """Give axis labels without text a place: matplotlib would look for one beside all tick labels."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if not axis.label.get_text():
                axis.set_label_coords(0.0, 0.0)


def unit(quantity: str, prefix: str = "") -> str:
    """The unit as it is printed: ``m/s^2`` with a raised 2."""
    return prefix + UNITS[quantity].replace("^2", "\N{SUPERSCRIPT TWO}")


def raised(unit: str) -> str:
    """A parameter's unit with raised powers: ``N/m^3``."""
    return re.sub(r"\^([\d.]+)", r"$^{\1}$", unit)


def unit_prefix(magnitude: float, kilo: bool = False) -> tuple[float, str]:
    """The factor and the SI prefix with which a value reads between 0.1 and 1000: 0.02 m is 20 mm, 5e9 N is 5 GN.

    Args:
        magnitude: The largest absolute value to be shown, in the base unit; 0 or NaN keeps the base unit.
        kilo: Whether values from 1000 become kilo-units and larger (forces, not displacements).
    """
    if not magnitude > 0.0:
        return 1.0, ""
    if kilo and magnitude >= 1e3:
        large = ((1e-12, "T"), (1e-9, "G"), (1e-6, "M"), (1e-3, "k"))
        return next((factor, prefix) for factor, prefix in large if magnitude * factor >= 1.0 - 1e-9)
    prefixes = ((1.0, ""), (1e3, "m"), (1e6, "\N{MICRO SIGN}"))
    return next(((factor, prefix) for factor, prefix in prefixes if magnitude * factor >= 0.1), (1e9, "n"))
