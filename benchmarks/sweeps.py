"""What a sweep costs beside its training: `make bench-sweeps`, or `python -m benchmarks.sweeps --jobs 64`.

Runs the same default jobs, told apart by their seeds, one after the other in one process and with joblib on all cores,
and prints jobs per minute and where the processes' time goes. The last line puts a thousand finished jobs together.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from pinn_cli.runs.process import usable_cores

# Stages of run.json in which a job computes; all else is start-up: importing, composing, simulating, writing.
COMPUTING = ("estimate", "posterior", "baseline", "free_run")
COLLECTED = 1000


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=64)
    parser.add_argument("overrides", nargs="*", help="further overrides of every job")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        basic = _timed(place / "basic", 1, options.jobs, options.overrides)
        joblib = _timed(
            place / "joblib", len(usable_cores()), options.jobs, [*options.overrides, "hydra/launcher=joblib"]
        )
        print(f"joblib / basic: {basic / joblib:.2f} times the throughput")
        _collect(place / "joblib", place / "many")


def _timed(place: Path, processes: int, jobs: int, overrides: list[str]) -> float:
    """Wall-clock seconds of a sweep."""
    command = [sys.executable, "-m", "pinn_cli.main", "--multirun", f"seed=range({jobs})", f"hydra.sweep.dir={place}"]
    began = time.perf_counter()
    subprocess.run([*command, *overrides], check=True, capture_output=True)
    wall = time.perf_counter() - began
    stages: Counter[str] = Counter()
    for record in place.glob("*/run.json"):
        stages.update(json.loads(record.read_text())["seconds"])
    computing = sum(stages[name] for name in COMPUTING)
    outside = processes * wall - stages.pop("total")
    told = ", ".join(f"{name} {seconds:.1f}" for name, seconds in stages.most_common() if seconds >= 0.1)
    print(f"{place.name}: {jobs} jobs in {wall:.1f} s, {60 * jobs / wall:.1f} a minute, {processes} at once")
    print(f"  seconds of all processes: {told}, outside the jobs {outside:.1f}")
    print(f"  start-up {100 * (1 - computing / (processes * wall)):.0f} %")
    return wall


def _collect(sweep: Path, place: Path) -> None:
    """Put a thousand jobs together that are copies of those of a sweep."""
    jobs = sorted(sweep.glob("seed=*"), key=lambda job: int(job.name.partition("=")[2].partition("_")[0]))
    place.mkdir()
    stored = (sweep / "multirun.yaml").read_text()
    (place / "multirun.yaml").write_text(stored.replace(f"seed=range({len(jobs)})", f"seed=range({COLLECTED})"))
    for seed in range(COLLECTED):
        job = jobs[seed % len(jobs)]
        copy = place / job.name.replace(f"seed={seed % len(jobs)}", f"seed={seed}")
        shutil.copytree(job, copy, ignore=shutil.ignore_patterns("*.nc"))
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "pinn_cli.main", f"collect={place}"], check=True, capture_output=True, text=True
    )
    print(f"collect: {time.perf_counter() - began:.1f} s; {done.stdout.partition(chr(10))[0]}")


if __name__ == "__main__":
    main()
