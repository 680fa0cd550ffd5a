"""What may lie in the folder of a trial: nothing, a run that has finished, one that was stopped, a sweep, a record."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from calls import SMALL

QUICK = (*SMALL, "figures=false")
STEPS = (*QUICK, "network=mlp", "training=adam", "network.depth=2", "network.width=8", "training.iterations=3")
STEPPED = (*STEPS, "training.collocation_points=48", "training.checkpoint_every_s=1e-6")
FINISHED = (*QUICK, "hydra.run.dir=run")
STOPPED = (*STEPPED, "hydra.run.dir=run")
SWEPT = (*QUICK, "--multirun", "seed=0,1", "hydra.sweep.dir=sweep")
STARTS = {"finished": FINISHED, "stopped": STOPPED, "swept": SWEPT}
# The last file that a run writes.
LAST = "run.json"


class Starts:
    """Folders to copy, made when they are first asked for.

    Args:
        folder: Where they are kept.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def lay(self, start: str, place: Path) -> None:
        """Put a start into a new folder."""
        if start == "empty":
            place.mkdir()
            return
        if not (self.folder / start).is_dir():
            self._make(start)
        shutil.copytree(self.folder / start, place, symlinks=True)

    def _make(self, start: str) -> None:
        made = self.folder / f".{start}"
        made.mkdir(parents=True)
        command = [sys.executable, "-m", "pinn_cli.main", *STARTS[start]]
        subprocess.run(command, cwd=made, check=True, capture_output=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
        if start == "stopped":  # as if it was killed before it wrote its last file
            (made / "run" / LAST).unlink()
        made.rename(self.folder / start)
