"""Estimated system parameters with their 90 % intervals: unknown ones as they are, prescribed ones as they moved."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from pinn_cli.report.figures import style
from pinn_cli.report.figures.parameter_panels import draw_change, draw_value
from pinn_cli.training.estimated_chain import split_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

    from pinn_cli.training.estimate import ParameterEstimate

_ROW, _TOP, _BOTTOM = 2.3, 0.5, 0.39  # inch: of a row of panels, and of its legend and titles, its ticks and labels
_LEFT, _RIGHT = 0.55, 0.08


def parameters_figure(
    estimates: Sequence[ParameterEstimate],
    true: Mapping[str, np.ndarray] | None,
    units: Mapping[str, str] | None = None,
    titles: Mapping[str, str] | None = None,
) -> Figure:
    """One panel per symbol, over the connections, with 90 % intervals; unknown parameters above prescribed ones.

    Unknown parameters are drawn as they are, in their unit, with the values from which the search for them started.
    Prescribed ones are drawn as relative changes from what was prescribed; where that is zero they are left out.

    Args:
        estimates: At least one that can be drawn.
        true: Symbol to values (dof,), marked where known; or None.
        units: Symbol to the unit of unknown parameters, powers as ``m^3``.
        titles: Symbol to its name in words.

    Raises:
        ValueError: If there is nothing to draw.
    """
    unknown = _by_symbol(given for given in estimates if given.unknown)
    prescribed = _by_symbol(given for given in estimates if given.prescribed and not given.unknown)
    rows = [row for row in (unknown, prescribed) if row]
    if not rows:
        raise ValueError("there is no estimated parameter that is unknown or has a prescribed value other than zero")
    with style.look():
        width = min(1.2 + 2.0 * max(map(len, rows)), style.PAGE_WIDTH)
        figure = Figure(figsize=(width, _ROW * len(rows)))
        places = [figure] if len(rows) == 1 else np.asarray(figure.subfigures(len(rows), 1)).tolist()
        for place, row in zip(places, rows, strict=True):
            panels = _panels(place, width, len(row))
            for axes, (symbol, group) in zip(panels, row.items(), strict=True):
                title = f"{(titles or {}).get(symbol, '')} {style.symbol(symbol)}".strip()
                if row is unknown:
                    unit = draw_value(axes, group, true, (units or {}).get(symbol, ""))
                    title += f" ({style.raised(unit)})" if unit else ""
                else:
                    draw_change(axes, group, true)
                axes.set_title(title, pad=4)
            panels[0].set_ylabel("Identified value" if row is unknown else "Change from prescribed (%)")
            _legend(place, panels)
    return figure


def _by_symbol(estimates: Iterable[ParameterEstimate]) -> dict[str, list[ParameterEstimate]]:
    groups: dict[str, list[ParameterEstimate]] = {}
    for given in estimates:
        groups.setdefault(split_name(given.name)[0], []).append(given)
    return groups


def _panels(place: Figure | SubFigure, width: float, count: int) -> list[Axes]:
    grid = place.add_gridspec(
        1,
        count,
        left=_LEFT / width,
        right=1.0 - _RIGHT / width,
        top=1.0 - _TOP / _ROW,
        bottom=_BOTTOM / _ROW,
        wspace=0.28,
    )
    return list(grid.subplots(squeeze=False)[0])


def _legend(place: Figure | SubFigure, panels: Sequence[Axes]) -> None:
    """One legend above the row, of all that occurs in any of its panels."""
    handles = {
        label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    # Matplotlib lists what has error bars last; what only a later panel has must not come after it.
    labels = sorted(handles, key=lambda label: label.startswith("estimate"))
    place.legend(
        [handles[label] for label in labels], labels, loc="upper center", bbox_to_anchor=(0.5, 1.0), ncols=len(labels)
    )
