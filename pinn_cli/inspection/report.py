"""What a look at a record leaves behind."""

from __future__ import annotations

from pathlib import Path

from pinn_cli.inspection.inspection import Inspection
from pinn_cli.inspection.text import inspection_text
from pinn_cli.runs.writing import write_table


def write_inspection(found: Inspection, directory: Path, figures: bool = True) -> str:
    """Write ``inspect.csv`` (channels), ``peaks.csv`` and ``figures/inspect``; the text that is printed.

    Args:
        found: What there is to say.
        directory: Of the run.
        figures: Whether to draw.
    """
    write_table(found.channels, directory / "inspect.csv")
    write_table(found.peaks, directory / "peaks.csv")
    if figures:
        from pinn_cli.inspection.figure import inspection_figure
        from pinn_cli.report.figures.style import save

        save(inspection_figure(found), directory / "figures", "inspect")
    return inspection_text(found)
