"""Tracking with MLflow: by default a SQLite file, which needs no server."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from sqlite3 import connect
from typing import TYPE_CHECKING, TypeVar

from pinn_cli.runs.lock import locked
from pinn_cli.runs.tracking_state import NOTHING, TrackingState
from pinn_cli.runs.writing import replacing
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import true_or_false
from pinn_cli.settings.paths import located
from pinn_cli.tracking.base import FAILED, FINISHED, INTERRUPTED, TrackedRun, Tracker, Tracking, require
from pinn_cli.tracking.mlflow_store import SQLITE, Store
from pinn_cli.tracking.outcome import Outcome

if TYPE_CHECKING:
    from mlflow.entities import Run
    from mlflow.tracking import MlflowClient

Result = TypeVar("Result")

STATUS = {FINISHED: "FINISHED", FAILED: "FAILED", INTERRUPTED: "KILLED"}
# Tag with the key that the run's directory has.
KEY = "key"
# What MLflow takes in one request, and how long a text may be.
MOST_METRICS, MOST_PARAMS, LONGEST = 1000, 100, 500
# A database that other processes write to is tried again for so long.
PATIENCE_S, FIRST_WAIT_S = 60.0, 0.1


class MlflowTracking(Tracking):
    """One run of MLflow for each run.

    Args:
        uri: Of the tracking store; a relative SQLite file starts where pinn-run is called, and ``~`` is home.
            ``http://...`` is a server.
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
        start = (base or Path()).absolute()
        self.store = Store.of(uri, start)
        if not isinstance(experiment, str) or not experiment.strip():
            raise InputError("tracking.experiment", experiment, "a text")
        self.experiment, self.files = experiment, true_or_false("tracking.files", files)
        self.artifacts = self._artifacts(artifacts, start)

    def _artifacts(self, given: object, start: Path) -> Path | None:
        """The folder of the runs' files; None where the server says where they go."""
        if given is not None and (not isinstance(given, str) or not given):
            raise InputError("tracking.artifacts", given, "null or a folder")
        if given is None:
            database = self.store.database
            return None if database is None else database.with_name(f"{database.stem}-artifacts")
        folder = located(given, start)
        if os.path.lexists(folder) and not folder.is_dir():
            raise InputError("tracking.artifacts", given, "null or a folder", "what is there is no folder")
        return folder

    def open(self, tracked: TrackedRun, state: TrackingState, known: bool) -> MlflowTracker:
        """See :meth:`Tracking.open`."""
        self.store.check()
        try:
            client, experiment = self._connected()
            found = _patiently(lambda: _found(client, state.key)) if known else None
            if found is None:
                run, params, logged = self._new(client, experiment, tracked, state.key), {}, NOTHING
            else:
                run, params = found.info.run_id, found.data.params
                logged = _last_row(client, run)
                _patiently(lambda: client.update_run(run, status="RUNNING"))
            _log_params(client, run, tracked.settings, params)
            return MlflowTracker(client, run, self.files, logged)
        except Exception as error:
            hint = str(error).partition("\n")[0]
            raise InputError("tracking.uri", self.store.uri, "a store that MLflow can use", hint) from error

    def abandon(self, key: str) -> None:
        """See :meth:`Tracking.abandon`."""
        client = self._client()
        found = _patiently(lambda: _found(client, key))
        if found is not None and found.info.status == "RUNNING":
            MlflowTracker(client, found.info.run_id, self.files).end(INTERRUPTED, "cut off; its directory is another's")

    def _connected(self) -> tuple[MlflowClient, str]:
        """A client, and the number of the experiment; one process at a time, so that there is one database and one."""
        database = self.store.database
        if database is None:
            client = self._client()
            return client, self._experiment(client)
        database.parent.mkdir(parents=True, exist_ok=True)
        with locked(database.with_name(f".{database.name}.lock")):
            if not database.exists():
                self._make_tables(database)
            client = self._client()
            return client, self._experiment(client)

    def _make_tables(self, database: Path) -> None:
        """Make the database whole: MLflow does it in a thousand steps and cannot go on where it was killed in one."""
        beside = database.with_name(f".{database.name}.new")
        beside.unlink(missing_ok=True)
        self._client(f"{SQLITE}{beside}")
        # Not renamed: MLflow has it open to the end of the process.
        with replacing(database) as whole, closing(connect(beside)) as made, closing(connect(whole)) as copy:
            made.backup(copy)
        beside.unlink()

    def _client(self, uri: str | None = None) -> MlflowClient:
        # Read when MLflow is first imported. It is to tell nobody of its use, and us of trouble only.
        os.environ["MLFLOW_DISABLE_TELEMETRY"] = os.environ["DO_NOT_TRACK"] = "true"
        os.environ.setdefault("MLFLOW_LOGGING_LEVEL", "WARNING")
        logging.getLogger("alembic").setLevel(logging.WARNING)
        logging.getLogger("urllib3").setLevel(logging.ERROR)  # which tells each try
        from mlflow.tracking import MlflowClient

        return _patiently(lambda: MlflowClient(tracking_uri=uri or self.store.uri))

    def _new(self, client: MlflowClient, experiment: str, tracked: TrackedRun, key: str) -> str:
        tags = {**{n: str(v) for n, v in tracked.labels.items()}, "directory": str(tracked.directory), KEY: key}
        return str(_patiently(lambda: client.create_run(experiment, tags=tags, run_name=tracked.name)).info.run_id)

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

    def __init__(self, client: MlflowClient, run: str, files: bool, logged: float | None = None) -> None:
        self.client, self.run, self.files, self.logged = client, run, files, logged

    def rows(self, rows: Sequence[Mapping[str, float]]) -> None:
        """See :meth:`Tracker.rows`: the step is the iteration. A row is there whole or not at all."""
        at_once = MOST_METRICS // max(len(row) for row in rows)
        for first in range(0, len(rows), at_once):
            batch = rows[first : first + at_once]
            self._log(
                [(name, v, int(row["iteration"])) for row in batch for name, v in row.items() if name != "iteration"]
            )

    def results(self, outcome: Outcome) -> None:
        """See :meth:`Tracker.results`: what is there of an earlier start is not told twice."""
        there = _patiently(lambda: self.client.get_run(self.run)).data.metrics
        self._log([(name, value, 0) for name, value in outcome.metrics.items() if there.get(name) != value])
        for file in outcome.files if self.files else ():
            if file.is_dir():
                self.client.log_artifacts(self.run, str(file), artifact_path=file.name)
            else:
                self.client.log_artifact(self.run, str(file))

    def end(self, status: str, reason: str) -> None:
        """See :meth:`Tracker.end`."""
        # Both are of this end, whatever an earlier one was.
        for tag, value in (("status", status), ("reason", reason[:LONGEST])):
            _patiently(lambda tag=tag, value=value: self.client.set_tag(self.run, tag, value))  # type: ignore[misc]
        _patiently(lambda: self.client.set_terminated(self.run, STATUS[status]))

    def delete(self) -> None:
        """See :meth:`Tracker.delete`."""
        _patiently(lambda: self.client.delete_run(self.run))

    def _log(self, metrics: Sequence[tuple[str, float, int]]) -> None:
        from mlflow.entities import Metric

        now = int(1000 * time.time())
        entities = [Metric(name, float(value), now, step) for name, value, step in metrics]
        for first in range(0, len(entities), MOST_METRICS):
            batch = entities[first : first + MOST_METRICS]
            _patiently(lambda batch=batch: self.client.log_batch(self.run, metrics=batch))  # type: ignore[misc]


def _found(client: MlflowClient, key: str) -> Run | None:
    """The run with that key; None where there is none, or it was deleted."""
    everywhere = [experiment.experiment_id for experiment in client.search_experiments()]
    found = client.search_runs(everywhere, f"tags.{KEY} = '{key}'", max_results=1)
    return found[0] if found else None


def _last_row(client: MlflowClient, run: str) -> float:
    """Iteration of the last row of the history that the store has."""
    return float(max((m.step for m in _patiently(lambda: client.get_metric_history(run, "seconds"))), default=NOTHING))


def _log_params(client: MlflowClient, run: str, settings: Mapping[str, str], there: Mapping[str, str]) -> None:
    """Those that are not there: MLflow takes no second value, such as that of a `threads` which has changed."""
    from mlflow.entities import Param

    named = {_legal(name): value[:LONGEST] for name, value in settings.items()}
    params = [Param(name, value) for name, value in named.items() if name not in there]
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
