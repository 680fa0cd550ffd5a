"""What may lie in the folder of a trial: nothing, a run that has finished, one that was stopped, a sweep, a record."""

import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

from calls import SMALL

MEASURED = (
    "data=csv", "data.path=rig.csv", "data.time=t", "data.force={1: f}", "data.acceleration={1: a}", "system=linear",
    "system.ndof=1", "system.m=1", "system.c=0.4", "system.k=40", "figures=false", "threads=1",
)  # fmt: skip
ROWS = 160
QUICK = (*SMALL, "figures=false")
STEPS = (*QUICK, "network=mlp", "training=adam", "network.depth=2", "network.width=8", "training.iterations=3")
STEPPED = (*STEPS, "training.collocation_points=48", "training.checkpoint_every_s=1e-6")
FINISHED = (*QUICK, "hydra.run.dir=run")
STOPPED = (*STEPPED, "hydra.run.dir=run")
SWEPT = (*QUICK, "--multirun", "seed=0,1", "hydra.sweep.dir=sweep")
SEARCHED = (
    *QUICK, "--multirun", "hydra/sweeper=search", "validation=heldout", "scheme.unobserved_fraction=0.3",
    "network.degree=3,4,5", "hydra.sweeper.n_trials=3", "hydra.sweep.dir=sweep",
)  # fmt: skip
WINDOWED = (
    *MEASURED, "scheme=state_parameter", "scheme.unknown=[k_1]", "data.window=4", "data.overlap=1", "hydra.run.dir=run",
)  # fmt: skip
STARTS = {"finished": FINISHED, "stopped": STOPPED, "swept": SWEPT, "searched": SEARCHED, "windowed": WINDOWED}
# Of a run that was killed: what it would have written next.
UNWRITTEN = {"stopped": ("run.json",), "windowed": ("run.json", "windows/0002/window.json")}


def rig() -> list[list[str]]:
    """A mass on a spring and a damper under a sum of sines, as cells; the header first."""
    step, rows, state = 0.05, [["t", "f", "a"]], [0.0, 0.0]
    for index in range(ROWS):
        force = sum(math.sin(0.9 * n * step * index + n) for n in range(1, 9))
        acceleration = force - 0.4 * state[1] - 40.0 * state[0]
        rows.append([f"{step * index:.2f}", f"{force:.6f}", f"{acceleration:.6f}"])
        for _ in range(50):
            state[1] += step / 50 * (force - 0.4 * state[1] - 40.0 * state[0])
            state[0] += step / 50 * state[1]
    return rows


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
        (made / "rig.csv").write_text("\n".join(",".join(row) for row in rig()), encoding="utf-8")
        command = [sys.executable, "-m", "pinn_cli.main", *STARTS[start]]
        subprocess.run(command, cwd=made, check=True, capture_output=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
        for name in UNWRITTEN.get(start, ()):
            (made / "run" / name).unlink()
        made.rename(self.folder / start)
