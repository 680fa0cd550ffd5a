"""Sweeps made of nothing but their files, and sweeps in processes of their own."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.sweep.composing import job_name, swept_settings
from pinn_cli.sweep.jobs import Failure, Sweep

BASIC = "hydra_plugins.pinn_run.sweepers.BasicSweeper"
SUBDIRECTORY = "${job_name:${hydra.overrides.task},x}"


def made_sweep(directory: Path, overrides: Sequence[str], tables: Mapping[str, str | None]) -> Sweep:
    """A sweep as Hydra and its jobs leave it, read back.

    Args:
        directory: Of the sweep; created.
        overrides: Of the sweep, as typed.
        tables: By the override that tells a job from the others: its `fitness.csv`, or None if it failed; a job that
            is not there has not started.
    """
    directory.mkdir(exist_ok=True)
    hydra = {"overrides": {"task": list(overrides)}, "sweep": {"subdir": SUBDIRECTORY}, "sweeper": {"_target_": BASIC}}
    (directory / "multirun.yaml").write_text(yaml.safe_dump({"hydra": hydra}))
    swept = swept_settings(overrides)
    shared = [override for override in overrides if setting_of(override) not in swept]
    for own, table in tables.items():
        job = directory / job_name([own, *shared], swept)
        (job / ".hydra").mkdir(parents=True)
        (job / ".hydra" / "overrides.yaml").write_text(yaml.safe_dump([own, *shared]))
        if table is None:
            Failure(3, "no luck, at all", "Traceback").write(job, [])
        else:
            (job / "fitness.csv").write_text(table)
            (job / "run.json").write_text(json.dumps({"seconds": {"total": 1.5}}))
    return Sweep.read(directory)


def mlflow_runs(database: Path) -> list[Any]:
    """The runs in MLflow's SQLite store."""
    from mlflow.tracking import MlflowClient

    client = MlflowClient(tracking_uri=f"sqlite:///{database}")
    return list(client.search_runs([e.experiment_id for e in client.search_experiments()]))


def start(folder: Path, *arguments: str, env: Mapping[str, str] | None = None) -> subprocess.Popen[str]:
    """`pinn-run` in that folder, in a process group of its own, as a shell starts it.

    Args:
        folder: Its current one.
        arguments: Of the command.
        env: Variables besides this process's.
    """
    command = [sys.executable, "-m", "pinn_cli.main", *arguments]
    return subprocess.Popen(
        command,
        cwd=folder,
        env={**os.environ, **(env or {})},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
