"""Loops of the connections with memory: force over elongation, with its band."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.report.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pinn_cli.report.connection_forces import ConnectionForces

LOOPS_IN_FULL = 6  # more connections than these: those whose force is largest
SAMPLES_SHOWN = 600  # about the largest elongation, of a longer record
BAND = 1.96  # standard deviations to either side of the estimate: 95 %


def hysteresis_figure(forces: ConnectionForces, truth_label: str = "truth") -> Figure:
    """A panel for each connection with memory: its force over its elongation, the 95 % band of the force, the truth.

    Args:
        forces: Of the estimate; some connection has memory.
        truth_label: What the legend calls the truth, which is drawn where it is known.
    """
    largest = np.argsort(-np.abs(forces.estimate[:, forces.memory]).max(axis=0), kind="stable")
    shown = np.sort(forces.memory[largest[:LOOPS_IN_FULL]])
    factor, prefix = style.unit_prefix(float(np.abs(forces.elongation[:, shown]).max()))
    of_force, force_prefix = style.unit_prefix(float(np.abs(forces.estimate[:, shown]).max()))
    with style.look():
        columns = min(3, len(shown))
        rows = -(-len(shown) // columns)
        figure, panels = style.panels(rows, columns, 2.1, margins=(0.62, 0.1, 0.42, 0.42), gaps=(0.62, 0.45))
        for axes, connection in zip(panels.flat, shown, strict=False):
            _draw(axes, forces, int(connection), factor, of_force)
            axes.set_title(forces.names[connection], pad=3)
        for axes in panels.flat[len(shown) :]:
            axes.set_visible(False)
        for axes in panels[:, 0]:
            axes.set_ylabel(f"Force ({style.unit('force', force_prefix)})", labelpad=2)
        for axes in panels[-1]:
            axes.set_xlabel(f"Elongation ({style.unit('displacement', prefix)})", labelpad=2)
        handles, labels = panels.flat[0].get_legend_handles_labels()
        named = [truth_label if label == "truth" else label for label in labels]
        figure.legend(handles, named, loc="upper center", ncols=3, frameon=False, bbox_to_anchor=(0.5, 1.0))
    return figure


def _draw(axes: Axes, forces: ConnectionForces, connection: int, factor: float, of_force: float) -> None:
    elongation = forces.elongation[:, connection]
    middle, half = int(np.argmax(np.abs(elongation))), SAMPLES_SHOWN // 2
    first = max(0, min(middle - half, len(elongation) - SAMPLES_SHOWN))
    part = slice(first, first + SAMPLES_SHOWN)
    e, r, std = (x[part, connection] for x in (forces.elongation, forces.estimate, forces.std))
    if np.isfinite(forces.true[:, connection]).any():
        x, y = forces.true_elongation[part, connection] * factor, forces.true[part, connection] * of_force
        axes.plot(x, y, color=style.BLACK, linewidth=1.0, label="truth")
    axes.plot(
        e * factor, r * of_force, color=style.VERMILLION, linewidth=0.8, linestyle=(0, (2.5, 1.2)), label="estimate"
    )
    # A band about a loop: its edges are loops too, drawn as bars at the samples.
    low, high = (r - BAND * std) * of_force, (r + BAND * std) * of_force
    axes.vlines(e * factor, low, high, color=style.VERMILLION, alpha=0.3, linewidth=1.2, label="95 % band")
