"""The figure of `make bench`: time, memory, factorisations and their rate against size, on logarithmic axes."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import pandas as pd

mpl.use("agg")

from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FormatStrFormatter, LogLocator, NullFormatter, NullLocator

AGAINST = {"ndof": "DOFs of a chain, 60 s", "duration_s": "duration (s), 6 DOFs", "topology": "DOFs, 60 s, by topology"}
# Of every row of panels: label, and column of the table to its label; of topologies the first column alone.
ROWS: tuple[tuple[str, dict[str, str]], ...] = (
    ("processor time (s)", {"training_cpu_s": "training", "whole_cpu_s": "whole run", "smoother_cpu_s": "smoother"}),
    ("peak memory (MiB)", {"memory_mib": "whole run"}),
    ("factorisations", {"factorisations": "in all"}),
    ("GFlop/s of factorisations", {"gflop_per_s": "factorisations"}),
)


def draw(table: pd.DataFrame, product_rate: float, folder: Path) -> list[Path]:
    """Draw what has been measured.

    Args:
        table: As :mod:`benchmarks.__main__` makes it.
        product_rate: Of the machine, GFlop/s: a line of its own.
        folder: Of ``scaling.png`` and ``scaling.pdf``.
    """
    shown = [name for name in AGAINST if (table["against"] == name).any()]
    figure, axes = plt.subplots(len(ROWS), len(shown), figsize=(3.4 * len(shown), 9.5), squeeze=False, sharex="col")
    for column, against in enumerate(shown):
        own = table[table["against"] == against]
        size = "duration_s" if against == "duration_s" else "ndof"
        for row, (label, lines) in enumerate(ROWS):
            panel = axes[row, column]
            _lines(panel, own, size, lines, by_topology=against == "topology")
            if "gflop_per_s" in lines:
                panel.axhline(product_rate, color="0.5", linestyle="--", label="matrix product")
            panel.set_xscale("log")
            panel.set_yscale("log")
            _plain_labels(panel, sorted(own[size].unique()))
            panel.grid(which="both", linewidth=0.3, alpha=0.5)
            panel.legend(fontsize=7)
            if column == 0:
                panel.set_ylabel(label)
        axes[-1, column].set_xlabel(AGAINST[against])
    figure.tight_layout()
    places = [folder / f"scaling.{kind}" for kind in ("png", "pdf")]
    for place in places:
        figure.savefig(place, dpi=150)
    plt.close(figure)
    return places


def _plain_labels(panel: Axes, sizes: list[float]) -> None:
    """Label the sizes that were measured, and few round values of what was."""
    panel.xaxis.set_major_locator(FixedLocator(sizes))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    panel.yaxis.set_minor_formatter(NullFormatter())
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_formatter(FormatStrFormatter("%g"))


def _lines(panel: Axes, own: pd.DataFrame, size: str, lines: dict[str, str], by_topology: bool) -> None:
    if by_topology:
        name = next(iter(lines))
        for topology, rows in own.groupby("topology", sort=False):
            panel.plot(rows[size], rows[name], marker="o", markersize=3, label=str(topology))
        return
    for name, label in lines.items():
        if name in own and own[name].notna().any():
            panel.plot(own[size], own[name], marker="o", markersize=3, label=label)
