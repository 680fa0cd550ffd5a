"""The models of a sweep: how far each lies behind the most probable one, and its free run on the validation data."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from pinn_cli.report.figures import style

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from pinn_cli.sweep.models import Comparison

# Behind the best by this much or more a model is out of the question (150 to 1; Kass and Raftery 1995).
DECISIVE = 5.0
_LEAST, _ROW = 0.1, 0.22  # nats, as the least bar is drawn; inch
_NONE = 1e-99  # a probability below this is written as zero


def models_figure(comparison: Comparison) -> Figure | None:
    """A bar for each model; None where they are not compared.

    Left: the logarithm of the Bayes factor against the most probable model of the same other settings, on a logarithmic
    axis; the shaded part is open. Right: the normalised mean square error of the free run, where there is validation
    data.
    """
    table = comparison.table
    if table is None:
        return None
    validated = bool(table["validation_nmse_percent"].notna().any())
    with style.look():
        height = 0.75 + _ROW * len(table)
        figure = Figure(figsize=(style.PAGE_WIDTH if validated else 4.6, height))
        panels = figure.subplots(1, 1 + validated, squeeze=False, sharey=True, gridspec_kw={
            "left": 0.24 if validated else 0.36, "right": 0.98, "top": 1.0 - 0.12 / height, "bottom": 0.48 / height,
            "wspace": 0.08,
        })[0]  # fmt: skip
        place = np.arange(len(table))[::-1]
        _draw_evidence(panels[0], table, place)
        panels[0].set_yticks(place, [_name(row, comparison) for _, row in table.iterrows()])
        if validated:
            error = table["validation_nmse_percent"].to_numpy()
            panels[1].barh(place, error, color=style.GREY, height=0.6)
            panels[1].set_xscale("log")
            panels[1].set_xlabel("free run on validation data, NMSE (%)")
    return figure


def _draw_evidence(axes: Axes, table: pd.DataFrame, place: np.ndarray) -> None:
    behind = -table["log_bayes_factor"].to_numpy()
    axes.axvspan(_LEAST, DECISIVE, color=style.SKY, alpha=0.25, linewidth=0)
    axes.barh(place, np.maximum(behind, _LEAST) - _LEAST, left=_LEAST, color=style.BLUE, height=0.6)
    axes.set_xscale("log")
    axes.set_xlim(_LEAST, max(20.0 * behind.max(), 10.0 * DECISIVE))
    for y, end, probability in zip(place, np.maximum(behind, _LEAST), table["probability"], strict=True):
        shown = f"p = {probability:.2g}" if probability > _NONE else "p = 0"
        axes.annotate(shown, (end, y), xytext=(3, 0), textcoords="offset points", va="center",
                      fontsize=6.5, color=style.BLACK)  # fmt: skip
    axes.set_xlabel("behind the most probable model (nats), and probability p")


def _name(row: pd.Series, comparison: Comparison) -> str:
    others = [name for name in row.index[: list(row.index).index("log_evidence")] if name not in comparison.settings]
    shown = [*comparison.settings, *others]
    values = [str(row[name]) for name in shown if name in row and row[name] == row[name]]
    return ", ".join(values)
