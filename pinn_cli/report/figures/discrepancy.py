"""The force that a model leaves out: over elongation, velocity and time, and its spectrum."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.lines import Line2D

from pinn_cli.record.spectrum import periodogram
from pinn_cli.report.figures import style
from pinn_cli.report.figures.decimate import line_indices

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pinn_cli.report.discrepancy import Discrepancy

MOST_DOTS = 4000  # of a longer record, evenly chosen


def discrepancy_figure(found: Discrepancy) -> Figure:
    """Four panels: dots and class means of the force over elongation and over velocity, its history, its spectrum.

    Friction is a step over the velocity, play a step over the elongation, a stiffer spring a bend. Above the first two
    stands the share of the force that a function of that alone explains.

    Args:
        found: Of one connection.
    """
    of_force, force_prefix = style.unit_prefix(float(np.abs(found.slow).max()), kilo=True)
    label = f"Force left out ({style.unit('force', force_prefix)})"
    with style.look():
        figure, panels = style.panels(2, 2, 1.9, margins=(0.62, 0.12, 0.5, 0.42), gaps=(0.62, 0.6))
        for axes, history, quantity, name in (
            (panels[0, 0], found.elongation, "displacement", "Elongation"),
            (panels[0, 1], found.velocity, "velocity", "Velocity"),
        ):
            _draw_over(axes, found, history, of_force)
            _, prefix = style.unit_prefix(float(np.abs(history).max()))
            axes.set_xlabel(f"{name} ({style.unit(quantity, prefix)})", labelpad=2)
        kept = line_indices(found.slow)
        panels[1, 0].plot(found.time[kept], of_force * found.slow[kept], color=style.BLUE, linewidth=0.6)
        panels[1, 0].set_xlabel("Time $t$ (s)", labelpad=2)
        panels[1, 0].set_xlim(found.time[0], found.time[-1])
        _draw_spectrum(panels[1, 1], found)
        for axes in (panels[0, 0], panels[1, 0]):
            axes.set_ylabel(label, labelpad=2)
        panels[1, 1].set_ylabel("Mean square (N\N{SUPERSCRIPT TWO})", labelpad=2)
        _legend(figure, found)
    return figure


def _draw_over(axes: Axes, found: Discrepancy, history: np.ndarray, of_force: float) -> None:
    factor, _ = style.unit_prefix(float(np.abs(history).max()))
    every = max(1, len(history) // MOST_DOTS)
    x, y, share = found.explained_by(history)
    axes.plot(
        factor * history[::every], of_force * found.slow[::every], color=style.SKY, **(style.DOTS | {"markersize": 2.0})
    )
    axes.plot(factor * x, of_force * y, color=style.VERMILLION, linewidth=1.2)
    axes.axhline(0.0, color=style.GREY, linewidth=0.5, zorder=0)
    axes.set_title(f"explains {100.0 * share:.0f} %", loc="right", fontsize=7, pad=2)


def _draw_spectrum(axes: Axes, found: Discrepancy) -> None:
    """Mean squares at every frequency, of all of the force and of what the other panels show."""
    step = float(found.time[1] - found.time[0])
    frequency, power = (x[1:] for x in periodogram(found.force, step))
    _, slow = (x[1:] for x in periodogram(found.slow, step))
    axes.plot(frequency, power, color=style.GREY, alpha=0.6, linewidth=0.6)
    axes.plot(frequency, np.where(slow > 1e-9 * slow.max(initial=0.0), slow, np.nan), color=style.BLUE, linewidth=0.6)
    for at in found.natural[(found.natural >= frequency[0]) & (found.natural <= frequency[-1])]:
        axes.axvline(at, color=style.BLACK, linewidth=0.8, linestyle=(0, (2.5, 1.2)))
    for at in found.missing:
        axes.axvline(at, color=style.VERMILLION, linewidth=1.0, linestyle=(0, (1, 1.2)))
    axes.set_xscale("log")
    axes.set_xlim(frequency[0], frequency[-1])
    axes.set_xlabel("Frequency (Hz)", labelpad=2)
    if power.max(initial=0.0) > 0.0:
        axes.set_yscale("log")


def _legend(figure: Figure, found: Discrepancy) -> None:
    handles = [
        Line2D([], [], color=style.BLUE, label=f"force left out, connection {found.connection}"),
        Line2D([], [], color=style.GREY, alpha=0.6, label="the same above its motion"),
        Line2D([], [], color=style.VERMILLION, linewidth=1.2, label="mean"),
    ]
    if len(found.natural):
        handles.append(Line2D([], [], color=style.BLACK, linestyle=(0, (2.5, 1.2)), label="natural frequency"))
    if found.missing:
        handles.append(Line2D([], [], color=style.VERMILLION, linestyle=(0, (1, 1.2)), label="mode not in the model"))
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 1.0), ncols=len(handles))
