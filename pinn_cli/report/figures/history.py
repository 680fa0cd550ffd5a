"""Loss terms and loss weights over the iterations of training."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator

from pinn_cli.report.figures import style

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
    # A term keeps its colour and its dashes in both panels, so that one legend is that of both.
    terms = list(dict.fromkeys(_term(name) for kind in shown for name in columns[kind]))
    with style.look():
        margins = (0.08 * style.PAGE_WIDTH, 0.3 * style.PAGE_WIDTH, 0.1, 0.38)
        figure, panels = style.panels(len(shown), 1, 1.68, margins=margins, gaps=(0.0, 0.17), sharex=True)
        for axes, kind in zip(panels[:, 0], shown, strict=True):
            for name in columns[kind]:
                _draw_term(axes, history, name, terms.index(_term(name)))
            axes.set_yscale("log")
            axes.set_ylabel(_PANELS[kind])
            axes.yaxis.set_minor_locator(NullLocator())
            axes.grid(True, axis="y")
            axes.set_axisbelow(True)
        axes.set_xlabel("Iteration")
        axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
        figure.align_ylabels(list(panels[:, 0]))
        entries = {
            label: line for axes in panels.flat for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        beside = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.02), "borderaxespad": 0.0, "handlelength": 2.8}
        panels[0, 0].legend(list(entries.values()), list(entries), **beside)
    return figure


def _term(column: str) -> str:
    return column.partition("_")[2].replace("_", " ")


def _draw_term(axes: Axes, history: pd.DataFrame, column: str, position: int) -> None:
    iterations, values = history["iteration"].to_numpy(), history[column].to_numpy(dtype=float)
    kept = np.flatnonzero(np.isfinite(values) & (values > 0.0))
    if kept.size:
        kept = kept[style.line_indices(np.log(values[kept]))]
    axes.plot(
        iterations[kept], values[kept], color=style.CYCLE[position % len(style.CYCLE)],
        linestyle=_LINES[position % len(_LINES)], marker="o" if len(iterations) <= _MARKED else "none", markersize=2.2,
        label=_term(column),
    )  # fmt: skip
