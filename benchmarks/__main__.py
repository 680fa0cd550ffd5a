"""Time and memory against DOFs, duration and topology: `make bench`, or `make bench ARGS=--full`.

Every row is one `pinn-run` in a process of its own, with its defaults (Duffing springs, SNR 50, 67 % of the DOFs
unobserved, uncertain parameters), figures included, beside the Kalman smoother on the same record where it is not too
large for it. Times are seconds of the processor. The exponents are slopes of the logarithms over all rows of a group.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from benchmarks.cases import Case, cases
from benchmarks.scaling_figure import draw

FOLDER = Path("outputs/bench")
# Of the linear algebra, from the start of a process: what counts a run imports it before the run limits its threads.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
GROUPS = ("ndof", "duration_s", "topology")
# A matrix product says what the machine can do: GFlop/s, the best of several.
TIMED_PRODUCT = """
import time, numpy as np
a, seconds = np.random.default_rng(0).normal(size=(1000, 1000)), []
for _ in range(6):
    began = time.process_time()
    a @ a
    seconds.append(time.process_time() - began)
print(2.0 / min(seconds))
"""


def measure(case: Case, scratch: Path, smoother: bool = True) -> dict[str, float | str]:
    """One run, and the smoother's where it takes part."""
    found = counted(case.command, scratch / "run")
    run = json.loads((scratch / "run" / "run.json").read_text())
    fitness = pd.read_csv(scratch / "run" / "fitness.csv").set_index(["group", "quantity"])["range_fitness_percent"]
    row: dict[str, float | str] = {name: value for name, value in asdict(case).items() if name != "overrides"}
    row |= {
        "training_cpu_s": found["estimate_cpu_s"],
        "whole_cpu_s": found["cpu_s"],
        "memory_mib": found["memory_mib"],
        "features_per_dof": run["training"]["features_per_dof"],
        "iterations": run["training"]["iterations"],
        "factorisations": found["factorisations"],
        "gflop": found["operations"] / 1e9,
        "gflop_per_s": found["operations"] / 1e9 / found["factoring_cpu_s"],
        "factoring_percent": 100.0 * found["factoring_cpu_s"] / found["estimate_cpu_s"],
        "displacement_fitness": fitness["all", "displacement"],
    }
    if smoother and case.smoothed:
        beside = counted([*case.command, "baseline=kalman_smoother", "figures=false"], scratch / "smoother")
        row["smoother_cpu_s"] = beside["baseline_cpu_s"]
    return row


def counted(command: list[str], directory: Path) -> dict[str, float]:
    """What one run took, see :mod:`benchmarks.counted_run`.

    Raises:
        subprocess.CalledProcessError: It failed.
    """
    place = directory.with_suffix(".json")
    own = [f"hydra.run.dir={directory}", "threads=1"]
    counting = [sys.executable, "-m", "benchmarks.counted_run", str(place), *command, *own]
    subprocess.run(counting, check=True, stdout=subprocess.DEVNULL, env=os.environ | ONE_THREAD)
    found: dict[str, float] = json.loads(place.read_text())
    return found


def product_rate() -> float:
    """Additions and multiplications of a matrix product, on one thread, per second: 1e9 of them."""
    done = subprocess.run(
        [sys.executable, "-c", TIMED_PRODUCT], check=True, capture_output=True, text=True, env=os.environ | ONE_THREAD
    )
    return float(done.stdout)


def exponent(size: pd.Series, values: pd.Series) -> float:
    """Least-squares slope of the logarithms; NaN of fewer than two rows."""
    known = values.notna() & (values > 0)
    if known.sum() < 2:
        return float("nan")
    return float(np.polyfit(np.log(size[known].astype(float)), np.log(values[known].astype(float)), 1)[0])


def exponents(table: pd.DataFrame) -> pd.DataFrame:
    """Of time and memory over DOFs or duration: a row for every group and topology."""
    rows = []
    for (against, topology), own in table.groupby(["against", "topology"], sort=False):
        size = own["duration_s" if against == "duration_s" else "ndof"]
        columns = ("training_cpu_s", "whole_cpu_s", "memory_mib", "gflop", "smoother_cpu_s")
        slopes = {name: exponent(size, own[name]) for name in columns if name in own}
        rows.append({"against": against, "topology": topology, **slopes})
    return pd.DataFrame(rows)


def main() -> None:
    """Measure, print, draw, and write ``outputs/bench/scaling.csv`` after every row."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--full", action="store_true", help="up to 200 DOFs, an hour of record and 100 masses in a grid"
    )
    parser.add_argument("--only", nargs="+", choices=GROUPS, default=GROUPS, help="these groups alone")
    parser.add_argument("--no-smoother", action="store_true", help="without the Kalman smoother")
    options = parser.parse_args()
    rate, rows = product_rate(), []
    print(f"one thread multiplies matrices at {rate:.1f} GFlop/s")
    FOLDER.mkdir(parents=True, exist_ok=True)
    for case in cases(options.full):
        if case.against not in options.only:
            continue
        began = time.perf_counter()
        with TemporaryDirectory() as scratch:
            row = measure(case, Path(scratch), not options.no_smoother)
        rows.append(row | {"product_gflop_per_s": rate})
        table = pd.DataFrame(rows)
        table.to_csv(FOLDER / "scaling.csv", index=False, float_format="%.6g")
        done = f"{case.topology}, {case.ndof} DOFs, {case.duration_s} s"
        print(
            f"{done}: training {row['training_cpu_s']:.1f} s ({time.perf_counter() - began:.0f} s on the clock)",
            flush=True,
        )
    print(table.drop(columns="product_gflop_per_s").to_string(index=False, float_format=lambda x: f"{x:.3g}"))
    print("\nexponents (processor time and memory over DOFs, or over the duration)")
    print(exponents(table).to_string(index=False, float_format=lambda x: f"{x:.2f}"))
    share = 100.0 * table["gflop"].sum() / (table["gflop"] / table["gflop_per_s"]).sum() / rate
    print(f"factorisations run at {share:.0f} % of the matrix product's rate over all rows")
    for place in (FOLDER / "scaling.csv", *draw(table, rate, FOLDER)):
        print(place)


if __name__ == "__main__":
    main()
