"""The paper's Figures 1 to 14: three schematics that are shipped, eleven that runs have drawn."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from pinn_cli.paper.runs import FinishedRun
from pinn_cli.runs.writing import replacing

FORMATS = ("png", "svg", "pdf")  # those that a browser shows come first


@dataclass(frozen=True)
class PaperFigure:
    """One figure of the paper (an entry of ``figures.yaml``).

    Attributes:
        number: In the paper.
        picture: Name of a file, without its ending: of a schematic or of a figure of the run.
        title: A few words, for headings and alternative text.
        caption: Sentences in our own words.
        run: Name of the run that draws it; empty for schematics.
    """

    number: int
    picture: str
    title: str
    caption: str
    run: str = ""

    @property
    def name(self) -> str:
        """Of its files."""
        return f"figure{self.number:02d}"


@cache
def paper_figures() -> tuple[PaperFigure, ...]:
    """All of them, in the paper's order."""
    listed: Any = OmegaConf.load(_shipped("figures.yaml"))
    figures = []
    for entry in listed.figures:
        remark = listed.remarks.get(entry.picture, "")
        figures.append(PaperFigure(**{**entry, "caption": f"{entry.caption} {remark}".strip()}))
    return tuple(figures)


def copy_figures(runs: Sequence[FinishedRun], directory: Path) -> dict[int, Path]:
    """Copy the schematics and the figures of the runs that are there, as ``figure01.svg``, ``figure01.pdf`` and so on.

    Args:
        runs: Those that are there.
        directory: Of the copies; created where it is missing.

    Returns:
        Number of a figure to its copy that a browser shows.
    """
    copies: dict[int, Path] = {}
    sources = {run.planned.name: run.directory / "figures" for run in runs} | {"": _shipped("schematics")}
    for figure in paper_figures():
        if figure.run not in sources:
            continue
        source = sources[figure.run]
        for ending in FORMATS:
            picture = source / f"{figure.picture}.{ending}"
            if picture.exists():
                with replacing(directory / f"{figure.name}.{ending}") as beside:
                    shutil.copyfile(picture, beside)
                copies.setdefault(figure.number, directory / f"{figure.name}.{ending}")
    return copies


def _shipped(name: str) -> Path:
    return Path(str(resources.files("pinn_cli.paper") / name))
