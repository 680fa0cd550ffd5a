"""One look for all figures: the paper's page, a palette that the colour-blind can read, and how a figure becomes files.

Figures are made through matplotlib's object-oriented interface, never through ``pyplot``: no global state, no window,
and no backend to choose.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure, SubFigure
from matplotlib.font_manager import fontManager
from matplotlib.ticker import MaxNLocator

from pinn_cli.runs.reading import printable
from pinn_cli.runs.writing import replacing
from pinn_cli.system.quantities import UNITS

PAGE_WIDTH = 7.2  # inch, the two columns of a journal's page

# Okabe and Ito's palette (2008), distinct under every common colour vision deficiency.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILLION, PURPLE, GREY = "#F0E442", "#0072B2", "#D55E00", "#CC79A7", "#7F7F7F"
CYCLE = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK)

SQUARED = "\N{SUPERSCRIPT TWO}"
Look = dict[str, Any]  # how matplotlib draws something
DOTS: Look = {"linestyle": "none", "marker": ".", "markersize": 4.0, "markeredgewidth": 0}

SYMBOLS = {
    "displacement": r"$u$", "velocity": r"$\dot{u}$", "acceleration": r"$\ddot{u}$", "force": r"$f$",
    "ground_acceleration": r"$\ddot{u}_g$", "connection_force": r"$r$", "support_displacement": r"$s$",
    "support_velocity": r"$\dot{s}$", "support_acceleration": r"$\ddot{s}$",
}  # fmt: skip

# Fonts with the signs of many scripts, for names that the first one cannot write.
_OTHER_FONTS = (
    "Noto Sans CJK", "Source Han Sans", "WenQuanYi", "Droid Sans Fallback", "Unifont",
    "Arial Unicode MS", "Hiragino Sans", "PingFang SC", "Yu Gothic", "Microsoft YaHei", "Malgun Gothic",
)  # fmt: skip

_STYLE: dict[Any, Any] = {
    "mathtext.fontset": "stix", "font.size": 8,
    "axes.titlesize": 8.5, "axes.labelsize": 8, "xtick.labelsize": 7, "ytick.labelsize": 7, "legend.fontsize": 8,
    "legend.frameon": False, "axes.linewidth": 0.6, "axes.edgecolor": "#404040",
    "xtick.direction": "in", "xtick.major.width": 0.6, "xtick.major.size": 2.5,
    "ytick.direction": "in", "ytick.major.width": 0.6, "ytick.major.size": 2.5,
    "lines.linewidth": 0.9, "lines.markersize": 3, "grid.linewidth": 0.4, "grid.color": "#D9D9D9",
    "axes.titley": 1.0,  # a fixed place: looking for what a title might collide with takes a third of the drawing time
    "axes.formatter.limits": (-6, 7), "axes.formatter.useoffset": False,  # prefixes of units do what offsets do
    "path.simplify": True,
    "pdf.fonttype": 42,  # journals refuse Type 3 fonts
    "savefig.dpi": 150,
}  # fmt: skip


@contextmanager
def look() -> Iterator[None]:
    """The look of this package's figures, for the length of a block; matplotlib's own settings are back afterwards."""
    with mpl.rc_context(_STYLE | {"font.family": _fonts()}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)  # it is drawn as an empty box
        yield


@cache
def _fonts() -> list[str]:
    """The figures' font, and what this machine has for other scripts."""
    there = sorted({font.name for font in fontManager.ttflist})
    return ["STIXGeneral", "DejaVu Sans", *(name for name in there if name.startswith(_OTHER_FONTS))]


def panels(
    rows: int, columns: int, height: float, *, width: float = PAGE_WIDTH,
    margins: tuple[float, float, float, float], gaps: tuple[float, float], **options: Any,
) -> tuple[Figure, np.ndarray]:  # fmt: skip
    """A figure and its grid of panels (rows, columns); fixed margins take a tenth of the time of a computed layout.

    In inch: the ``height`` of a panel, the figure's ``width``, ``margins`` left, right, top, bottom, and ``gaps``
    between neighbours, across and down. ``options`` are those of `matplotlib.figure.Figure.subplots`.
    """
    left, right, top, bottom = margins
    total = top + rows * height + (rows - 1) * gaps[1] + bottom
    panel = (width - left - right - (columns - 1) * gaps[0]) / columns
    figure = Figure(figsize=(width, total))
    places = {"left": left / width, "right": 1.0 - right / width, "top": 1.0 - top / total, "bottom": bottom / total}
    grid = places | {"wspace": gaps[0] / panel, "hspace": gaps[1] / height}
    return figure, np.asarray(figure.subplots(rows, columns, squeeze=False, gridspec_kw=grid, **options))


def legend(figure: Figure | SubFigure, axes: Iterable[Axes] | None = None, **options: Any) -> None:
    """One legend above, of all that has a label in any of the panels (or of these), each label once."""
    handles: dict[str, Any] = {}
    for panel in figure.axes if axes is None else axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    # Matplotlib lists what has error bars last; what only a later panel has must not come after it.
    labels = sorted(handles, key=lambda label: isinstance(handles[label], ErrorbarContainer))
    place: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, 1.0), "ncols": len(labels)}
    figure.legend([handles[label] for label in labels], labels, **{**place, **options})


def note(figure: Figure, text: str) -> None:
    """A small line at the foot, of what is left out."""
    figure.text(0.99, 0.002, text, ha="right", va="bottom", fontsize=7)


def head(axes: Axes, title: str) -> None:
    """What a column of panels shows, above the first of them, which has a unit or a number there."""
    axes.annotate(
        title, (0.5, 1.0), xycoords="axes fraction", xytext=(0, 14), textcoords="offset points", ha="center",
        fontsize=8.5,
    )  # fmt: skip


def ticks(axes: Axes) -> None:
    """A few round numbers on either axis."""
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10], min_n_ticks=3))


def largest(sizes: Sequence[float] | np.ndarray, most: int) -> list[int]:
    """Positions of the ``most`` largest sizes at most, in their order; what is NaN counts as zero."""
    kept = np.argsort(-np.nan_to_num(np.asarray(sizes, dtype=float)), kind="stable")[:most]
    return sorted(kept.tolist())


def line_indices(values: np.ndarray, points: int = 1500) -> np.ndarray:
    """Indices of at most ``points`` samples of a line (time,) without NaN that keep its outline, in increasing order.

    They are the lowest and highest of each bin; records shorter than that are kept whole.
    """
    samples = len(values)
    if samples <= points:
        return np.arange(samples)
    bins = max((points - 2) // 2, 1)
    width = -(-samples // bins)
    padded = np.pad(values, (0, bins * width - samples), mode="edge").reshape(bins, width)
    start = np.arange(bins) * width
    extremes = np.concatenate([start + padded.argmin(axis=1), start + padded.argmax(axis=1), [0, samples - 1]])
    return np.unique(np.minimum(extremes, samples - 1))


def save(figure: Figure, directory: Path | str, name: str) -> list[Path]:
    """Write ``figure`` as ``name.png`` (150 dpi) and ``name.pdf`` under ``directory``.

    The same figure gives the same bytes.
    """
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if not axis.label.get_text():
                axis.set_label_coords(0.0, 0.0)  # matplotlib would look for a place beside all tick labels
    # Creation dates and versions would make two equal runs differ.
    kinds: dict[str, dict[str, Any]] = {
        # Half the time of the usual level, a sixth more bytes.
        "png": {"metadata": {"Software": None}, "pil_kwargs": {"compress_level": 3}},
        "pdf": {"metadata": {"CreationDate": None, "Producer": None}},
    }
    written = [Path(directory) / f"{name}.{kind}" for kind in kinds]
    for place, (kind, options) in zip(written, kinds.items(), strict=True):
        with look(), replacing(place) as temporary:
            figure.savefig(temporary, format=kind, **options)
    return written


def for_notebooks(figure: Figure) -> Figure:
    """The same, which a notebook shows: those that pyplot has not made are shown by none of their own accord."""

    def png() -> bytes:
        content = BytesIO()
        with look():
            figure.savefig(content, format="png")
        return content.getvalue()

    figure._repr_png_ = png  # type: ignore[attr-defined]
    return figure


def literal(name: str) -> str:
    """A name, anybody's, as a text of a figure: no sign in it begins mathematics, or is one that no font has."""
    return printable(name).replace("$", r"\$")


def unit(quantity: str, prefix: str = "") -> str:
    """The unit as it is printed: ``m/s^2`` with a raised 2."""
    return prefix + UNITS[quantity].replace("^2", SQUARED)


def raised(unit: str) -> str:
    """A parameter's unit with raised powers: ``N/m^3``."""
    return re.sub(r"\^([\d.]+)", r"$^{\1}$", unit)


def unit_prefix(magnitude: float, kilo: bool = False) -> tuple[float, str]:
    """The factor and the SI prefix with which a value reads between 0.1 and 1000: 0.02 m is 20 mm, 5e9 N is 5 GN.

    ``magnitude`` is the largest absolute value to be shown, in the base unit; 0 or NaN keeps the base unit. Values from
    1000 become kilo-units and larger where ``kilo`` says so (forces, not displacements).
    """
    if not magnitude > 0.0:
        return 1.0, ""
    if kilo and magnitude >= 1e3:
        large = ((1e-12, "T"), (1e-9, "G"), (1e-6, "M"), (1e-3, "k"))
        return next((factor, prefix) for factor, prefix in large if magnitude * factor >= 1.0 - 1e-9)
    prefixes = ((1.0, ""), (1e3, "m"), (1e6, "\N{MICRO SIGN}"))
    return next(((factor, prefix) for factor, prefix in prefixes if magnitude * factor >= 0.1), (1e9, "n"))
