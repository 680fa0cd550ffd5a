"""Which parameters the record cannot tell apart: their posterior correlation as a matrix."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from pinn_cli.report.figures import style

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from pinn_cli.system.parameters import Parameter
    from pinn_cli.training.estimate import ParameterEstimate

ANNOTATED = 16  # parameters up to which every cell has its number: as many as fit across a page
LABELLED = 60  # parameters up to which every row has its name

_LEFT, _RIGHT, _TOP, _BOTTOM = 0.5, 0.75, 0.3, 0.4  # inch
_CELL, _LEAST = 0.34, 1.2  # inch, of a cell and of the matrix


def correlation_figure(estimates: Sequence[ParameterEstimate], correlation: np.ndarray) -> Figure:
    """The correlation matrix, unknown parameters first; a line parts them from the prescribed ones.

    Args:
        estimates: p of them, at least two.
        correlation: (p, p), in their order.

    Raises:
        ValueError: If there are fewer than two parameters.
    """
    count = len(estimates)
    if count < 2:
        raise ValueError("a correlation takes two parameters")
    order = sorted(range(count), key=lambda i: not estimates[i].unknown)
    unknown = sum(p.unknown for p in estimates)
    matrix = np.asarray(correlation)[np.ix_(order, order)]
    side = max(min(_CELL * count, style.PAGE_WIDTH - _LEFT - _RIGHT), _LEAST)
    width, height = _LEFT + side + _RIGHT, _BOTTOM + side + _TOP
    with style.look():
        figure = Figure(figsize=(width, height))
        axes = figure.add_axes((_LEFT / width, _BOTTOM / height, side / width, side / height))
        # A parameter's correlation with itself says nothing and would be the darkest of all cells.
        shown = np.ma.masked_where(np.eye(count, dtype=bool) | ~np.isfinite(matrix), matrix)
        axes.patch.set_facecolor("#E6E6E6")
        image = axes.imshow(shown, cmap=colormaps["RdBu_r"], vmin=-1.0, vmax=1.0, interpolation="nearest")
        bar = figure.colorbar(image, cax=axes.inset_axes((1.0 + 0.1 / side, 0.0, 0.12 / side, 1.0)))
        bar.outline.set_linewidth(0.4)
        bar.set_label("Posterior correlation")
        _name_rows(axes, [estimates[i].parameter for i in order])
        _part(axes, unknown, count)
        if count <= ANNOTATED:
            _annotate(axes, shown)
    return figure


def _name_rows(axes: Axes, parameters: Sequence[Parameter]) -> None:
    symbols, named = [p.symbol for p in parameters], any(p.label for p in parameters)
    kept = range(0, len(symbols), math.ceil(len(symbols) / LABELLED))
    labels = [symbols[i] for i in kept]
    size = 8.0 if len(symbols) <= ANNOTATED else 6.0
    axes.set_xticks(kept, labels, fontsize=size, rotation=0 if len(symbols) <= ANNOTATED and not named else 90)
    axes.set_yticks(kept, labels, fontsize=size)
    axes.tick_params(length=0)


def _part(axes: Axes, unknown: int, count: int) -> None:
    """A line between unknown and prescribed parameters, and what is which above."""
    if 0 < unknown < count:
        for line in (axes.axhline, axes.axvline):
            line(unknown - 0.5, color=style.BLACK, linewidth=0.9)
    for label, first, end in (("unknown", 0, unknown), ("prescribed", unknown, count)):
        if end > first:
            axes.annotate(
                label, ((first + end) / 2 - 0.5, 1.0), xycoords=axes.get_xaxis_transform(), xytext=(0, 4),
                textcoords="offset points", ha="center", va="bottom", fontsize=8,
            )  # fmt: skip


def _annotate(axes: Axes, shown: np.ma.MaskedArray) -> None:
    for (row, column), value in np.ndenumerate(shown.filled(np.nan)):
        if np.isfinite(value):
            colour = "white" if abs(value) > 0.65 else style.BLACK
            text = f"{round(value, 2) + 0.0:.2f}".replace("-", "\N{MINUS SIGN}")  # + 0.0: no minus before a zero
            axes.text(column, row, text, ha="center", va="center", fontsize=6, color=colour)
