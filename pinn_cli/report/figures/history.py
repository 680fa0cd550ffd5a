"""Loss terms and loss weights over the iterations of training."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MaxNLocator, NullLocator

from pinn_cli.report.figures import style
from pinn_cli.report.figures.decimate import line_indices

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MARKED = 60  # iterations up to which each is marked
_PANELS = {"loss": "Loss term", "weight": r"Loss weight $\lambda$"}
_LINES = ("-", "--", "-.", ":")


def history_figure(history: pd.DataFrame) -> Figure:
    """Columns ``loss_*`` in the upper panel, ``weight_*`` in the lower one, over ``iteration``, on logarithmic scales.

    A panel whose columns are missing is left out; values that are not positive have no place on the scale and are left
    out.

    Raises:
        ValueError: If there is no such column.
    """
    columns = {kind: [str(name) for name in history if str(name).startswith(f"{kind}_")] for kind in _PANELS}
    shown = [kind for kind in _PANELS if columns[kind]]
    if not shown:
        raise ValueError(f"the history has no loss_* or weight_* column, only {', '.join(map(str, history))}")
    terms = list(dict.fromkeys(_term(name) for kind in shown for name in columns[kind]))
    with style.look():
        margins = (0.08 * style.PAGE_WIDTH, 0.3 * style.PAGE_WIDTH, 0.1, 0.38)
        figure, grid = style.panels(len(shown), 1, 1.68, margins=margins, gaps=(0.0, 0.17), sharex=True)
        panels = grid[:, 0]
        for axes, kind in zip(panels, shown, strict=True):
            for name in columns[kind]:
                _draw_term(axes, history, name, terms.index(_term(name)))
            _dress(axes, _PANELS[kind])
        panels[-1].set_xlabel("Iteration")
        panels[-1].xaxis.set_major_locator(MaxNLocator(8, integer=True))
        figure.align_ylabels(list(panels))
        _legend(panels)
    return figure


def _term(column: str) -> str:
    return column.partition("_")[2].replace("_", " ")


def _draw_term(axes: Axes, history: pd.DataFrame, column: str, position: int) -> None:
    iterations = history["iteration"].to_numpy()
    values = history[column].to_numpy(dtype=float)
    kept = np.flatnonzero(np.isfinite(values) & (values > 0.0))
    if kept.size:
        kept = kept[line_indices(np.log(values[kept]))]
    axes.plot(
        iterations[kept],
        values[kept],
        color=style.CYCLE[position % len(style.CYCLE)],
        linestyle=_LINES[position % len(_LINES)],
        marker="o" if len(iterations) <= _MARKED else "none",
        markersize=2.2,
        label=_term(column),
    )


def _dress(axes: Axes, label: str) -> None:
    axes.set_yscale("log")
    axes.set_ylabel(label)
    axes.yaxis.set_minor_locator(NullLocator())
    axes.grid(True, axis="y")
    axes.set_axisbelow(True)


def _legend(panels: np.ndarray) -> None:
    """One legend for both panels, since a term keeps its colour and its dashes in both."""
    entries = {label: line for axes in panels for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    panels[0].legend(
        list(entries.values()),
        list(entries),
        loc="upper left",
        bbox_to_anchor=(1.01, 1.02),
        borderaxespad=0.0,
        handlelength=2.8,
    )
