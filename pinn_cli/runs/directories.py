"""The directories that Hydra makes before a run's input can be judged, and taking them away again.

Hydra makes a run's directory before the task sees the configuration. A command that its input makes impossible must
leave nothing behind, and must not touch what was there before it.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from pinn_cli.runs.ownership import is_prepared

# Directories that did not exist before the run or sweep that was started last, outermost first.
_new: list[Path] = []


def note_new(directory: Path) -> None:
    """Note the directory of a run or of a sweep, and its parents, as far as they are missing."""
    path = directory.absolute()
    _new[:] = [p for p in (path, *path.parents) if not os.path.lexists(p)]


def discard() -> None:
    """Remove what unusable input left: directories that are new and in which no run was begun."""
    for directory in _new:
        if os.path.isdir(directory) and all(map(is_prepared, directory.iterdir())):
            shutil.rmtree(directory)
