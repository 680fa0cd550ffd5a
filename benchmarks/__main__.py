"""Time of training, and how it grows with the number of DOFs and with the record's length: `make bench`.

Every row is one `pinn-run` in a process of its own, with its defaults (Duffing chain, SNR 50, 67 % of the DOFs
unobserved, uncertain parameters), figures included. `start_s` is what passes until it reads or simulates its record;
`table_at_s`, until it prints its table; `whole_s`, until its process has ended. The exponents are slopes of log time
over log size from the first row to the last.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd

# The paper samples 60 s with 4096 points; longer records keep the rate.
SAMPLES_PER_MINUTE = 4096
# Stages of run.json before there is a record.
START = ("start_up", "config", "imports")
BY_DOFS = [(6, 60), (20, 60), (100, 60)]
BY_DURATION = [(6, 60), (6, 240), (6, 960)]


def measure(ndof: int, duration: int, directory: Path) -> dict[str, float]:
    """One run: its seconds, iterations, memory and range fitness over all DOFs."""
    overrides = {
        "system.ndof": ndof,
        "simulation.duration": duration,
        "simulation.samples": SAMPLES_PER_MINUTE * duration // 60,
        "hydra.run.dir": directory,
    }
    command = [sys.executable, "-m", "pinn_cli.main", *(f"{name}={value}" for name, value in overrides.items())]
    began = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    whole = time.perf_counter() - began
    run = json.loads((directory / "run.json").read_text())
    fitness = pd.read_csv(directory / "fitness.csv")
    fitness = fitness[fitness["group"] == "all"].set_index("quantity")["range_fitness_percent"]
    return {
        "ndof": ndof,
        "duration_s": duration,
        "training_s": run["seconds"]["estimate"],
        "start_s": sum(run["seconds"][stage] for stage in START),
        "table_at_s": run["seconds"]["table_at"],
        "whole_s": whole,
        "iterations": run["training"]["iterations"],
        "features_per_dof": run["training"]["features_per_dof"],
        "memory_mib": run["peak_memory_mib"]["process"],
        **{f"fitness_{quantity}": fitness[quantity] for quantity in ("displacement", "velocity", "acceleration")},
    }


def exponent(table: pd.DataFrame, size: str) -> float:
    """Slope of log training time over log size, from the first row to the last."""
    first, last = table.iloc[0], table.iloc[-1]
    return math.log(last["training_s"] / first["training_s"]) / math.log(last[size] / first[size])


def main() -> None:
    """Measure, print and write ``outputs/bench/scaling.csv``."""
    folder = Path("outputs/bench")
    folder.mkdir(parents=True, exist_ok=True)
    tables = {}
    with TemporaryDirectory() as scratch:
        for size, cases in (("ndof", BY_DOFS), ("duration_s", BY_DURATION)):
            rows = []
            for i, case in enumerate(cases):
                rows.append(measure(*case, Path(scratch) / f"{size}_{i}"))
                print(f"{case[0]} DOFs, {case[1]} s: training {rows[-1]['training_s']:.1f} s", flush=True)
            tables[size] = pd.DataFrame(rows)
            print(tables[size].round(2).to_string(index=False))
            print(f"training time grows with {size} to the power {exponent(tables[size], size):.2f}\n", flush=True)
    pd.concat(tables, names=["scaling"]).reset_index("scaling").to_csv(folder / "scaling.csv", index=False)
    print(folder / "scaling.csv")


if __name__ == "__main__":
    main()
