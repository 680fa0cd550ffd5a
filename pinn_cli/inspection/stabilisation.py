"""The stabilisation diagram: poles by order over the sensors' spectra, and the modes that came of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator, ScalarFormatter

from pinn_cli.report.figures import style
from pinn_cli.report.figures.style import line_indices

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pinn_cli.inspection.modes import ModalRecord

RECORDS, SINGULAR_VALUES = 6, 3  # of them are drawn
ROOM = 2.0  # beyond the modes, as a factor of frequency
ACROSS = 8.0  # wider than this factor the axis is logarithmic
DECADES = 8.0

_UNSTABLE: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 2.2, "color": "#BFBFBF", "zorder": 2}
_STABLE: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 2.4, "color": style.GREEN,
                           "markeredgewidth": 0, "zorder": 3}  # fmt: skip
_FIRST: dict[str, Any] = {"color": style.BLUE, "linewidth": 0.8}
_FURTHER: dict[str, Any] = {"color": style.SKY, "linewidth": 0.6}
_MODE: dict[str, Any] = {"color": style.VERMILLION, "linewidth": 0.8, "zorder": 1}
_MACHINE: dict[str, Any] = {"color": style.ORANGE, "linewidth": 0.8, "linestyle": ":", "zorder": 1}


def stabilisation_figure(records: Sequence[ModalRecord]) -> Figure:
    """A panel for each record."""
    shown = records[:RECORDS]
    with style.look():
        figure, panels = style.panels(len(shown), 1, 2.3, margins=(0.5, 0.62, 0.34, 0.44), gaps=(0.0, 0.42))
        for number, (axes, record) in enumerate(zip(panels[:, 0], shown, strict=True), start=1):
            _draw(axes, record)
            if len(records) > 1:
                axes.set_title(f"Record {number}", loc="left", pad=3)
        panels[-1, 0].set_xlabel("Frequency (Hz)", labelpad=2)
        style.legend(figure, handlelength=1.4, columnspacing=1.4)
        if len(records) > RECORDS:
            style.note(figure, f"{len(records) - RECORDS} further records are left out")
    return figure


def _draw(axes: Axes, record: ModalRecord) -> None:
    poles = record.identified.stabilisation
    low, high = _reach(record)
    within = (poles.frequency >= low) & (poles.frequency <= high)
    for stable, look, label in ((False, _UNSTABLE, "pole"), (True, _STABLE, "stable pole")):
        some = within & (poles.stable == stable)
        axes.plot(poles.frequency[some], poles.order[some], label=label, **look)
    for i, mode in enumerate(record.modes):
        axes.axvline(mode.frequency, label="mode" if i == 0 else None, **_MODE)
    for i, frequency in enumerate(record.identified.machines):
        axes.axvline(frequency, label="steady line, no mode" if i == 0 else None, **_MACHINE)
    axes.set_ylim(0, float(np.max(poles.order, initial=2)) + 1)
    axes.set_ylabel("order")
    axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    beside = axes.twinx()
    values, f = record.decomposition[0], record.spectra.frequency
    seen = np.flatnonzero((f >= low) & (f <= high) & (f > 0))
    for k in range(min(values.shape[1], SINGULAR_VALUES)):
        line = values[seen, k] ** (2 if record.acting else 1)
        positive = np.where(line > 0.0, line, np.nan)
        kept = line_indices(np.nan_to_num(positive))
        look = _FIRST if k == 0 else _FURTHER
        beside.plot(
            f[seen][kept], positive[kept], label="singular values of the spectra" if k == 0 else None, zorder=0, **look
        )
    beside.set_yscale("log")
    top = float(np.nanmax(values[seen, 0], initial=1e-300)) ** (2 if record.acting else 1)
    beside.set_ylim(max(beside.get_ylim()[0], top * 10.0**-DECADES), 3.0 * top)
    beside.set_ylabel("singular value")
    beside.yaxis.set_minor_locator(NullLocator())
    axes.set_zorder(beside.get_zorder() + 1)
    axes.patch.set_visible(False)
    if high > ACROSS * low:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlim(low, high)


def _reach(record: ModalRecord) -> tuple[float, float]:
    """Frequencies that are drawn, Hz."""
    f = record.spectra.frequency
    found = [mode.frequency for mode in record.modes] or [f[1] * 4.0, f[-1]]
    return max(min(found) / ROOM, float(f[1])), float(min(max(found) * ROOM, f[-1]))
