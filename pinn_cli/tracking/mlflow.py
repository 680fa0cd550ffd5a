"""Tracking with MLflow: by default a SQLite file, which needs no server."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from pinn_cli.errors import InputError
from pinn_cli.tracking.base import FAILED, FINISHED, INTERRUPTED, Job, Tracker, Tracking, require
from pinn_cli.tracking.file_lock import alone
from pinn_cli.tracking.outcome import Outcome

if TYPE_CHECKING:
    from mlflow.tracking import MlflowClient

Result = TypeVar("Result")

SQLITE = "sqlite:///"
STATUS = {FINISHED: "FINISHED", FAILED: "FAILED", INTERRUPTED: "KILLED"}
# What MLflow takes in one request, and how long a text may be.
MOST_METRICS, MOST_PARAMS, LONGEST = 1000, 100, 500
# A database that other processes write to is tried again for so long.
PATIENCE_S, FIRST_WAIT_S = 60.0, 0.1


class MlflowTracking(Tracking):
    """One run of MLflow for each run.

    Args:
        uri: Of the tracking store; a relative SQLite file starts where pinn-run is called. ``http://...`` is a server.
        experiment: That runs are listed under.
        artifacts: Folder for the runs' files, where the store is a SQLite file; None: beside it.
        files: Whether the run's files are copied there, or only its numbers are kept.
        base: The folder that relative paths start from; None: the current one.

    Raises:
        InputError: MLflow is not installed, or a setting is none.
    """

    name = "mlflow"

    def __init__(
        self,
        uri: str = "sqlite:///outputs/mlflow.db",
        experiment: str = "pinn-run",
        artifacts: str | None = None,
        files: bool = True,
        base: Path | None = None,
    ) -> None:
        require("mlflow", self.name)
        for setting, value in (("uri", uri), ("experiment", experiment)):
            if not isinstance(value, str) or not value:
                raise InputError(f"tracking.{setting}", value, "a text")
        if not isinstance(files, bool):
            raise InputError("tracking.files", files, "true or false")
        self.experiment, self.files = experiment, files
        start = (base or Path()).absolute()
        self.database = start / uri.removeprefix(SQLITE) if uri.startswith(SQLITE) else None
        self.uri = uri if self.database is None else f"{SQLITE}{self.database}"
        beside = None if self.database is None else self.database.with_name(f"{self.database.stem}-artifacts")
        self.artifacts = beside if artifacts is None else start / artifacts

    def open(self, job: Job, known: str | None) -> MlflowTracker:
        """See :meth:`Tracking.open`."""
        try:
            # MLflow makes its tables step by step; a second process that begins meanwhile fails over half of them.
            with alone(self.database):
                client = self._client()
                experiment = self._experiment(client)
            run = _patiently(lambda: self._again(client, known)) if known else None
            return MlflowTracker(client, run or self._new(client, experiment, job), self.files)
        except Exception as error:
            hint = str(error).partition("\n")[0]
            raise InputError("tracking.uri", self.uri, "a store that MLflow can use", hint) from error

    def _client(self) -> MlflowClient:
        # Read when MLflow is first imported. It is to tell nobody of its use, and us of trouble only.
        os.environ["MLFLOW_DISABLE_TELEMETRY"] = os.environ["DO_NOT_TRACK"] = "true"
        os.environ.setdefault("MLFLOW_LOGGING_LEVEL", "WARNING")
        logging.getLogger("alembic").setLevel(logging.WARNING)
        from mlflow.tracking import MlflowClient

        return _patiently(lambda: MlflowClient(tracking_uri=self.uri))

    def _again(self, client: MlflowClient, known: str) -> str | None:
        """The run to go on with; None where the store has lost it."""
        from mlflow.exceptions import MlflowException

        try:
            if client.get_run(known).info.lifecycle_stage != "active":
                return None
        except MlflowException as error:
            if error.error_code == "RESOURCE_DOES_NOT_EXIST":
                return None
            raise
        client.update_run(known, status="RUNNING")
        return known

    def _new(self, client: MlflowClient, experiment: str, job: Job) -> str:
        tags = {**{n: str(v) for n, v in job.labels.items()}, "directory": str(job.directory)}
        run: str = _patiently(lambda: client.create_run(experiment, tags=tags, run_name=job.name)).info.run_id
        _log_params(client, run, job.settings)
        return run

    def _experiment(self, client: MlflowClient) -> str:
        found = _patiently(lambda: client.get_experiment_by_name(self.experiment))
        if found is not None:
            return str(found.experiment_id)
        place = None if self.artifacts is None else self.artifacts.as_uri()
        try:
            return str(client.create_experiment(self.experiment, artifact_location=place))
        except Exception:  # another process was faster
            found = client.get_experiment_by_name(self.experiment)
            if found is None:
                raise
            return str(found.experiment_id)


class MlflowTracker(Tracker):
    """One run of MLflow."""

    def __init__(self, client: MlflowClient, run: str, files: bool) -> None:
        self.client, self.key, self.files = client, run, files

    def rows(self, rows: Sequence[Mapping[str, float]]) -> None:
        """See :meth:`Tracker.rows`: the step is the iteration."""
        self._log([(name, v, int(row["iteration"])) for row in rows for name, v in row.items() if name != "iteration"])

    def results(self, outcome: Outcome) -> None:
        """See :meth:`Tracker.results`."""
        self._log([(name, value, 0) for name, value in outcome.metrics.items()])
        for file in outcome.files if self.files else ():
            if file.is_dir():
                self.client.log_artifacts(self.key, str(file), artifact_path=file.name)
            else:
                self.client.log_artifact(self.key, str(file))

    def end(self, status: str, reason: str) -> None:
        """See :meth:`Tracker.end`."""
        for tag, value in (
            ("status", status),
            ("reason", reason[:LONGEST]),
        ):  # of this end, whatever an earlier one was
            _patiently(lambda tag=tag, value=value: self.client.set_tag(self.key, tag, value))  # type: ignore[misc]
        _patiently(lambda: self.client.set_terminated(self.key, STATUS[status]))

    def forget(self) -> None:
        """See :meth:`Tracker.forget`."""
        _patiently(lambda: self.client.delete_run(self.key))

    def _log(self, metrics: Sequence[tuple[str, float, int]]) -> None:
        from mlflow.entities import Metric

        now = int(1000 * time.time())
        entities = [Metric(name, float(value), now, step) for name, value, step in metrics]
        for first in range(0, len(entities), MOST_METRICS):
            batch = entities[first : first + MOST_METRICS]
            _patiently(lambda batch=batch: self.client.log_batch(self.key, metrics=batch))  # type: ignore[misc]


def _log_params(client: MlflowClient, run: str, settings: Mapping[str, str]) -> None:
    from mlflow.entities import Param

    params = [Param(_legal(name), value[:LONGEST]) for name, value in settings.items()]
    for first in range(0, len(params), MOST_PARAMS):
        batch = params[first : first + MOST_PARAMS]
        _patiently(lambda batch=batch: client.log_batch(run, params=batch))  # type: ignore[misc]


def _legal(name: str) -> str:
    """MLflow's names have no brackets."""
    return name.replace("[", ".").replace("]", "")


def _patiently(call: Callable[[], Result]) -> Result:
    """The call's result, tried again while other processes hold the database."""
    begun, wait = time.monotonic(), FIRST_WAIT_S
    while True:
        try:
            return call()
        except Exception as error:
            if "database is locked" not in str(error) or time.monotonic() - begun > PATIENCE_S:
                raise
        time.sleep(wait)
        wait = min(2.0 * wait, 2.0)
