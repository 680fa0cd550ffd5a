"""What made a run: the content of run.json."""

from __future__ import annotations

import hashlib
import math
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES
from pinn_cli.report.parameters import ESTIMATE, estimate_rows
from pinn_cli.runs.identity import package_version
from pinn_cli.runs.reading import stamp
from pinn_cli.runs.resume import FORMAT

if TYPE_CHECKING:
    from pinn_cli.posterior.result import PosteriorResult
    from pinn_cli.record.record import Record
    from pinn_cli.report.results import Results, RunDescription
    from pinn_cli.verdict.finding import Verdict

PACKAGES = (
    "pinn-cli", "torch", "numpy", "scipy", "pandas", "xarray", "h5netcdf", "matplotlib", "hydra-core", "pyro-ppl",
    "arviz",
)  # fmt: skip


def run_record(results: Results, verdict: Verdict | None, seconds: Mapping[str, float]) -> dict[str, Any]:
    """Seconds by stage, the training's summary (iterations, why it stopped, ...), and what it takes to run it again."""
    run, observed = results.run, observed_digest(own.record for own in results.by_record)
    content = run_facts(run, results.estimate.summary, observed, seconds)
    content["parameters"] = parameters_of(estimate_rows(results.estimate.parameters))
    if results.further:
        content["records"] = [own.estimate.summary for own in results.by_record]
    if results.baseline:
        content["baseline"] = {"name": run.baseline, **results.baseline.summary}
    if results.posterior:
        content["posterior"] = _sampling(results.posterior)
    if results.score is not None:
        content["validation"] = {"name": run.validation, "score": _finite(results.score.value)}
        content["validation"] |= {"reason": results.score.reason} if results.score.reason else {}
    return content | (verdict.record() if verdict else {})


def run_facts(
    run: RunDescription, summary: Mapping[str, Any], observed: str, seconds: Mapping[str, float]
) -> dict[str, Any]:
    """What is said of every run: its training's summary, the digest of what it observed, seconds by stage."""
    return {
        **stamp(FORMAT),
        "case": run.case,
        "seconds": {name: round(value, 4) for name, value in seconds.items()},
        "training": {"dtype": "float64", **summary},
        "peak_memory_mib": peak_memory_mib(),
        "seed": run.seed,
        "device": device_name(run.device),
        "threads": run.threads,
        "command": [Path(sys.argv[0]).name, *sys.argv[1:]],
        "configuration": run.configuration,
        "observed": observed,
        "git_revision": git_revision(),
        "versions": package_versions(),
        "platform": platform.platform(),
    }


def parameters_of(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Name, estimate, deviation and 90 % interval of every row of ``parameters.csv``; None where one is not known."""
    rows = table[["parameter", *ESTIMATE]].rename(columns={"parameter": "name"}).to_dict(orient="records")
    return [{str(k): x if isinstance(x, str) else _finite(x) for k, x in row.items()} for row in rows]


def _sampling(posterior: PosteriorResult) -> dict[str, Any]:
    samples, worst = posterior.samples, posterior.diagnostics
    chains, draws = samples.draws.shape[:2]
    return {
        "method": samples.method,
        "chains": chains,
        "warmup": samples.warmup,
        "draws": draws,
        "seconds_by_chain": [round(float(seconds), 3) for seconds in samples.seconds],
        "largest_r_hat": _finite(worst["r_hat"].max()),
        "smallest_ess_bulk": _finite(worst["ess_bulk"].min()),
        "smallest_ess_tail": _finite(worst["ess_tail"].min()),
        "quality_check": list(posterior.verdict) or "passed",
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def observed_digest(records: Iterable[Record]) -> str:
    """SHA-256, in part, of the samples of every sensor of one record or more, and of what is known of the forces.

    Runs with the same one saw the same record through the same sensors. A sensor with a calibration of its own counts
    by its samples, not by what they are believed to mean.
    """
    digest = hashlib.sha256()

    def add(name: str, values: np.ndarray) -> None:
        digest.update(f"{name} {values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())

    for record in records:
        add("time", record.time)
        digest.update(f"{record.intersample} {record.frame}".encode())
        add("unforced", record.unforced)
        for quantity in (*QUANTITIES, *record.response_quantities[len(RESPONSE_QUANTITIES) :]):
            measured = record.sensors(quantity) & ~record.gauged(quantity)
            add(quantity, measured)
            add(quantity, record.histories(quantity)[:, measured])
        for gauge in record.gauges:
            add(gauge.name, gauge.time)
            add(gauge.quantity, gauge.values)
    return digest.hexdigest()[:16]


def peak_memory_mib() -> dict[str, float | None]:
    """The most memory that this process has held, MiB; on the GPU, the most that torch had allocated there."""
    import torch

    cuda = round(torch.cuda.max_memory_allocated() / 2**20, 1) if torch.cuda.is_available() else None
    try:
        import resource
    except ImportError:  # Windows
        return {"process": None, "cuda": cuda}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    process = round(peak / (2**20 if sys.platform == "darwin" else 2**10), 1)  # macOS counts bytes, Linux KiB
    return {"process": process, "cuda": cuda}


def device_name(device: str) -> str:
    """The device, with the name of the GPU."""
    if device == "cpu":
        return device
    import torch

    return f"{device} ({torch.cuda.get_device_name(device)})"


@cache  # a sweep asks for every job
def git_revision() -> str | None:
    """The commit that runs, `-dirty` if files differ from it; None for an installed package, whose version says it."""
    checkout = Path(__file__).parents[2]
    if not (checkout / ".git").exists():
        return None
    # A repository's own configuration and git's variables may name programs that git would run.
    quiet = ["--no-pager", "--no-optional-locks", "-c", "core.fsmonitor=false", "-c", f"core.hooksPath={os.devnull}"]
    command = ["git", *quiet, "-C", str(checkout), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10, env=environment)
        return done.stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


def package_versions() -> dict[str, str | None]:
    """Version of Python and of every package that a run computes with; None where one is not installed."""
    return {"python": platform.python_version(), **{name: package_version(name) for name in PACKAGES}}
