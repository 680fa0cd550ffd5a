"""What a run leaves for later ones: ``run.json``, what made it; ``model.npz``, what is known of the structure."""

from __future__ import annotations

import hashlib
import logging
import math
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pinn_cli.model.file import write_model
from pinn_cli.model.knowledge import Levels, Model, ParameterKnowledge
from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES
from pinn_cli.report.parameters import ESTIMATE, estimate_rows
from pinn_cli.runs.identity import package_version
from pinn_cli.runs.reading import stamp
from pinn_cli.runs.resume import FORMAT
from pinn_cli.system.quantities import CALIBRATION_UNITS, GROUND
from pinn_cli.training.estimate import Estimate, estimated_structure
from pinn_cli.training.record_scales import force_and_velocity_scale

if TYPE_CHECKING:
    from pinn_cli.posterior.posterior import PosteriorResult
    from pinn_cli.record.record import Record
    from pinn_cli.report.results import Results, RunDescription
    from pinn_cli.verdict.finding import Verdict

NOTED_PACKAGES = (
    "pinn-cli", "torch", "numpy", "scipy", "pandas", "xarray", "h5netcdf", "matplotlib", "hydra-core", "pyro-ppl",
    "arviz-stats",
)  # fmt: skip

_log = logging.getLogger(__name__)


def run_record(results: Results, verdict: Verdict | None, seconds: Mapping[str, float]) -> dict[str, Any]:
    """Seconds by stage, the training's summary (iterations, why it stopped, ...), and what it takes to run it again."""
    run, observed = results.run, observed_digest(of_record.record for of_record in results.by_record)
    content = run_facts(run, _summary(results.estimate), observed, seconds)
    content["parameters"] = parameters_of(estimate_rows(results.estimate.parameters))
    if results.further:
        content["records"] = [_summary(of_record.estimate) for of_record in results.by_record]
    if results.baseline:
        content["baseline"] = {"name": run.baseline, **_summary(results.baseline)}
    if results.posterior:
        content["posterior"] = _sampling(results.posterior)
    if results.score is not None:
        content["validation"] = {"name": run.validation, "score": _finite(results.score.value)}
        content["validation"] |= {"reason": results.score.reason} if results.score.reason else {}
    return content | (verdict.record() if verdict else {})


def _summary(estimate: Estimate) -> dict[str, Any]:
    return estimate.summary | estimate.noise.summary


def run_facts(
    run: RunDescription, summary: Mapping[str, Any], observed: str, seconds: Mapping[str, float]
) -> dict[str, Any]:
    """What is said of every run: its training's summary, the digest of what it observed, seconds by stage."""
    trained = {"dtype": "float64", "device": "cpu", **summary}  # fixed features are solved by the processor
    device = trained["device"]
    if device != "cpu":
        import torch

        device = f"{device} ({torch.cuda.get_device_name(device)})"
    return {
        **stamp(FORMAT),
        "case": run.case,
        "seconds": {name: round(value, 4) for name, value in seconds.items()},
        "training": {name: value for name, value in trained.items() if name != "device"},
        "peak_memory_mib": peak_memory_mib(),
        "seed": run.seed,
        "device": device,
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
            measured = record.plain(quantity)
            add(quantity, measured)
            add(quantity, record.histories(quantity)[:, measured])
        for channel in record.calibrated:
            add(channel.key, channel.time)
            add(channel.quantity, channel.measured)
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
    return {"python": platform.python_version(), **{name: package_version(name) for name in NOTED_PACKAGES}}


def model_of(results: Results, verdict: Verdict | None) -> Model:
    """The identified structure of a run, whose estimate has the parameters of its posterior."""
    estimate = results.estimate
    parameters = [p.parameter for p in estimate.parameters]
    kept = np.array([i for i, p in enumerate(parameters) if p.kind not in CALIBRATION_UNITS], dtype=int)
    draws = None if results.posterior is None else results.posterior.samples.pooled
    knowledge = estimate.known if draws is None else None
    reasons = verdict.reasons if verdict else ()
    return Model(
        estimated_structure(results.prescribed, estimate.parameters),
        tuple(parameters[i] for i in kept),
        (knowledge or _knowledge(estimate, draws)).of(kept),
        _levels(results),
        None if estimate.end is None else replace(estimate.end, with_parameters=estimate.end.with_parameters[:, kept]),
        verdict.word if verdict else "",
        next((finding.text for finding in reasons), ""),
        None if draws is None else draws[:, kept],
        misfit=estimate.misfit,
    )


def write_run_model(results: Results, verdict: Verdict | None, directory: Path) -> None:
    """Write ``model.npz``, unless a law that somebody added has settings that are no plain values."""
    try:
        write_model(model_of(results, verdict), directory)
    except TypeError as error:
        _log.warning("model.npz is not written: a law of the structure cannot be stored (%s)", error)


def _knowledge(estimate: Estimate, draws: np.ndarray | None) -> ParameterKnowledge:
    """From draws of the posterior (D, p), or from deviations and correlation; NaN where a training gives none."""
    parameters, nothing = estimate.parameters, np.zeros(len(estimate.parameters))
    mean, std, prior = (np.array([getattr(p, name) for p in parameters]) for name in ("estimate", "std", "prior_std"))
    if draws is not None:
        covariance = np.atleast_2d(np.cov(draws, rowvar=False))
        return ParameterKnowledge(draws.mean(axis=0), covariance, nothing, nothing, prior)
    correlation = estimate.correlation
    if correlation is None:
        correlation = np.where(np.eye(len(parameters)) > 0, 1.0, 0.0 if len(parameters) == 1 else np.nan)
    return ParameterKnowledge(mean, correlation * np.outer(std, std), nothing, nothing, prior)


def _levels(results: Results) -> Levels:
    noise, record = results.estimate.noise, results.record
    columns = {*QUANTITIES, GROUND, *record.supports}
    sensors = {quantity: levels for quantity, levels in noise.sensors.items() if quantity in columns}
    force = np.nan if results.problem is None else force_and_velocity_scale(results.problem)[0]
    features = float(results.estimate.summary.get("features_per_dof", np.nan))
    return Levels(sensors, noise.discrepancy, record.step, float(force), features / record.duration)
