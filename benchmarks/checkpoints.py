"""What checkpoints cost: the paper's network and optimiser on its 6-DOF case, one checkpoint every 30 s.

    python -m benchmarks.checkpoints

A training is interrupted for as long as it takes to pack its state, write it and have the disk confirm it.
"""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from pinn_cli.cli.composing import compose_config
from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.prepare import prepare_problem
from pinn_cli.runs.checkpoint import LAST, Checkpoints, Resumable
from pinn_cli.runs.identity import Identity
from pinn_cli.training.estimate import RunContext

WRITES, WARMUP = 20, 20


class Timed(Checkpoints):
    """Checkpoints after every so many steps; how long each took, s."""

    def __init__(self, directory: Path, identity: Identity, every_s: float | None) -> None:
        super().__init__(directory, identity, every_s)
        self.packing: list[float] = []
        self.writing: list[float] = []
        self.asked = 0

    def due(self) -> bool:
        """At every second step, so that steps without one can be timed too."""
        self.asked += 1
        return self.asked > WARMUP and self.asked % 2 == 0

    def packed(self, training: Resumable, ended: bool = False) -> bytes:
        """See :meth:`Checkpoints.packed`."""
        began = time.perf_counter()
        data = super().packed(training, ended)
        self.packing.append(time.perf_counter() - began)
        return data

    def write(self, packed: bytes) -> None:
        """See :meth:`Checkpoints.write`."""
        began = time.perf_counter()
        super().write(packed)
        self.writing.append(time.perf_counter() - began)


def main() -> None:
    """Measure and print."""
    overrides = ["experiment=[paper/sr_6dof_snr50,paper_training]", "training.stages=1"]
    overrides += [f"training.iterations={WARMUP + 2 * WRITES}", "training.history_every=1"]
    config = RunConfig.read(compose_config(overrides))
    problem = prepare_problem(config).problem
    with TemporaryDirectory(dir=".") as scratch:
        kept = Timed(Path(scratch), config.identity, config.checkpoint_every_s)
        estimate = config.estimator.solve(problem, RunContext(directory=Path(scratch), checkpoints=kept))
        size = (Path(scratch) / LAST).stat().st_size
    once = statistics.median(kept.packing) + statistics.median(kept.writing)
    step = float(estimate.history["seconds"].diff().min())
    print(f"step                {1e3 * step:8.1f} ms")
    print(f"packing             {1e3 * statistics.median(kept.packing):8.1f} ms")
    print(f"writing and syncing {1e3 * statistics.median(kept.writing):8.1f} ms, {size / 2**20:.1f} MiB")
    print(f"share of the time   {100 * once / (config.checkpoint_every_s or 30.0):8.3f} % at one every 30 s")
    print(f"worst               {100 * (max(kept.packing) + max(kept.writing)) / 30.0:8.3f} %")


if __name__ == "__main__":
    main()
