"""Tracking with MLflow, which is told of a run once, when that has ended; by default a SQLite file, without a server.

What can be found out about a store without MLflow is found out before the run begins. MLflow itself would import
drivers by the name in a URI, make its tables in any database, and try a server that does not answer for minutes.
"""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from sqlite3 import SQLITE_BUSY, DatabaseError, connect
from typing import TYPE_CHECKING
from urllib.parse import urlsplit
from urllib.request import getproxies

from pinn_cli.runs.lock import locked
from pinn_cli.runs.writing import replacing
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import located, true_or_false
from pinn_cli.tracking.base import FAILED, FINISHED, INTERRUPTED, TrackedRun, Tracker, Tracking, require
from pinn_cli.tracking.outcome import Outcome

if TYPE_CHECKING:
    from mlflow.entities import Metric, Run
    from mlflow.tracking import MlflowClient

SQLITE, SERVERS = "sqlite:///", ("http", "https")
ALLOWED = "a SQLite file, sqlite:///FILE, or a server, http://HOST:PORT"
# How a database begins; one that was only just made is empty.
SQLITE_HEADER = b"SQLite format 3\0"
# Some of the tables that every store of MLflow has.
TABLES = {"experiments", "runs", "metrics", "params", "tags", "alembic_version"}
# A server is waited for so long, s, for each of two tries, and a file that another program has locked; of a server what
# the user's environment says counts more.
ANSWER_S = 10
_LIMITS = {
    "MLFLOW_HTTP_REQUEST_TIMEOUT": str(ANSWER_S),
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",
    "MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR": "1",
}

# A run that is being told is KILLED until all is told: should the process be killed, it does not run for ever.
STATUS, HALF_TOLD = {FINISHED: "FINISHED", FAILED: "FAILED"}, "KILLED"
# Tag with the key that the run's directory has.
KEY = "key"
# What MLflow takes in one request, and how long a text may be.
MOST_METRICS, MOST_PARAMS, LONGEST = 1000, 100, 500


class MlflowTracking(Tracking):
    """One run of MLflow for each run.

    Args:
        uri: Of the tracking store; a relative SQLite file starts where pinn-run is called, and ``~`` is home.
            ``http://...`` is a server.
        experiment: That runs are listed under.
        artifacts: Folder for the runs' files, where the store is a SQLite file; None: beside it.
        files: Whether the run's files are copied there, or only its numbers are kept.
        base: The folder that relative paths start from; None: the current one.

    Attributes:
        database: The SQLite file, absolute; None for a server.

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
        self.uri, self.database = uri, None
        given = uri if isinstance(uri, str) and uri.isprintable() else ""
        if given.startswith(SQLITE) and given.removeprefix(SQLITE).strip(" /"):
            self.database = located(uri.removeprefix(SQLITE), start)
            self.uri = f"{SQLITE}{self.database}"
        elif _address(given) is None:
            raise InputError("tracking.uri", uri, ALLOWED)
        if not isinstance(experiment, str) or not experiment.strip():
            raise InputError("tracking.experiment", experiment, "a text")
        self.experiment, self.files = experiment, true_or_false("tracking.files", files)
        self.artifacts = self._artifacts(artifacts, start)

    def _artifacts(self, given: object, start: Path) -> Path | None:
        """The folder of the runs' files; None where the server says where they go."""
        if given is not None and (not isinstance(given, str) or not given):
            raise InputError("tracking.artifacts", given, "null or a folder")
        if given is None:
            return None if self.database is None else self.database.with_name(f"{self.database.stem}-artifacts")
        folder = located(given, start)
        if os.path.lexists(folder) and not folder.is_dir():
            raise InputError("tracking.artifacts", given, "null or a folder", "what is there is no folder")
        return folder

    def open(self, run: TrackedRun, key: str, before: str) -> MlflowTracker:
        """See :meth:`Tracking.open`."""
        if self.database is None:
            _check_server(self.uri)
        else:
            _check_database(self.uri, self.database)
        return MlflowTracker(self, run, key)

    @contextmanager
    def connected(self) -> Iterator[tuple[MlflowClient, str]]:
        """A client, and the number of the experiment; one process of ours at a time has a SQLite file."""
        if self.database is None:
            client = self._client(self.uri)
            yield client, self._experiment(client)
            return
        self.database.parent.mkdir(parents=True, exist_ok=True)
        with locked(self.database.with_name(f".{self.database.name}.lock")):
            _check_database(self.uri, self.database)
            if not self.database.exists():
                self._make_tables(self.database)
            client = self._client(self.uri)
            yield client, self._experiment(client)

    def _make_tables(self, database: Path) -> None:
        """Make the database whole: MLflow does it in a thousand steps and cannot go on where it was killed in one."""
        beside = database.with_name(f".{database.name}.new")
        beside.unlink(missing_ok=True)
        self._client(f"{SQLITE}{beside}")
        # Not renamed: MLflow has it open to the end of the process.
        with replacing(database) as whole, closing(connect(beside)) as made, closing(connect(whole)) as copy:
            made.backup(copy)
        beside.unlink()

    def _client(self, uri: str) -> MlflowClient:
        # Read when MLflow is first imported. It is to tell nobody of its use, and us of trouble only.
        os.environ["MLFLOW_DISABLE_TELEMETRY"] = os.environ["DO_NOT_TRACK"] = "true"
        os.environ.setdefault("MLFLOW_LOGGING_LEVEL", "WARNING")
        os.environ.update({name: value for name, value in _LIMITS.items() if name not in os.environ})
        logging.getLogger("alembic").setLevel(logging.WARNING)
        logging.getLogger("urllib3").setLevel(logging.ERROR)  # which tells each try
        logging.getLogger("mlflow.store.db.utils").setLevel(logging.CRITICAL)  # a traceback of what is raised anyway
        from mlflow.tracking import MlflowClient

        return MlflowClient(tracking_uri=uri)

    def _experiment(self, client: MlflowClient) -> str:
        found = client.get_experiment_by_name(self.experiment)
        if found is None:
            place = None if self.artifacts is None else self.artifacts.as_uri()
            try:
                return str(client.create_experiment(self.experiment, artifact_location=place))
            except Exception:  # another process was faster, on a server
                found = client.get_experiment_by_name(self.experiment)
                if found is None:
                    raise
        return str(found.experiment_id)


class MlflowTracker(Tracker):
    """One run of MLflow, made when the run has ended. One that was interrupted has not: it may go on.

    Args:
        tracking: Where.
        run: The run.
        key: Of it.
    """

    def __init__(self, tracking: MlflowTracking, run: TrackedRun, key: str) -> None:
        self.tracking, self.run, self.key = tracking, run, key
        self._rows: list[Mapping[str, float]] = []

    def row(self, row: Mapping[str, float]) -> None:
        """See :meth:`Tracker.row`."""
        self._rows.append(dict(row))

    def end(self, status: str, reason: str, outcome: Outcome | None) -> None:
        """See :meth:`Tracker.end`. What a process that was killed meanwhile has told is not told twice."""
        if status == INTERRUPTED:
            return
        with self.tracking.connected() as (client, experiment):
            told = _found(client, self.key) or self._new(client, experiment)
            run = told.info.run_id
            _log_params(client, run, self.run.settings, told.data.params)
            _log_rows(client, run, self._rows)
            if outcome is not None:
                results = {n: value for n, value in outcome.metrics.items() if told.data.metrics.get(n) != value}
                _log_metrics(client, run, [(name, value, 0) for name, value in results.items()])
                for file in outcome.files if self.tracking.files else ():
                    if file.is_dir():
                        client.log_artifacts(run, str(file), artifact_path=file.name)
                    else:
                        client.log_artifact(run, str(file))
            client.set_tag(run, "status", status)
            client.set_tag(run, "reason", reason[:LONGEST])
            client.set_terminated(run, STATUS[status])

    def _new(self, client: MlflowClient, experiment: str) -> Run:
        labels = {name: str(value) for name, value in self.run.labels.items()}
        tags = {**labels, "directory": str(self.run.directory), KEY: self.key}
        made = client.create_run(experiment, tags=tags, run_name=self.run.name)
        client.set_terminated(made.info.run_id, HALF_TOLD)
        return made


def _found(client: MlflowClient, key: str) -> Run | None:
    """The run with that key; None where there is none, or it was deleted."""
    everywhere = [experiment.experiment_id for experiment in client.search_experiments()]
    found = client.search_runs(everywhere, f"tags.{KEY} = '{key}'", max_results=1)
    return found[0] if found else None


def _log_params(client: MlflowClient, run: str, settings: Mapping[str, str], there: Mapping[str, str]) -> None:
    """Those that are not there: MLflow takes no second value, such as that of a `threads` which has changed."""
    from mlflow.entities import Param

    named = {name.replace("[", ".").replace("]", ""): value for name, value in settings.items()}  # it takes no brackets
    params = [Param(name, value[:LONGEST]) for name, value in named.items() if name not in there]
    for first in range(0, len(params), MOST_PARAMS):
        client.log_batch(run, params=params[first : first + MOST_PARAMS])


def _log_rows(client: MlflowClient, run: str, rows: Sequence[Mapping[str, float]]) -> None:
    """Those that are not there; the step is the iteration. A row is there whole or not at all."""
    last = max((metric.step for metric in client.get_metric_history(run, "seconds")), default=-1)
    left = [row for row in rows if row["iteration"] > last]
    at_once = MOST_METRICS // max(map(len, left), default=1)
    for first in range(0, len(left), at_once):
        batch = left[first : first + at_once]
        values = [(n, v, int(row["iteration"])) for row in batch for n, v in row.items() if n != "iteration"]
        _log_metrics(client, run, values)


def _log_metrics(client: MlflowClient, run: str, metrics: Sequence[tuple[str, float, int]]) -> None:
    """Values by name, each at its step."""
    from mlflow.entities import Metric

    now = int(1000 * time.time())
    entities: list[Metric] = [Metric(name, float(value), now, step) for name, value, step in metrics]
    for first in range(0, len(entities), MOST_METRICS):
        client.log_batch(run, metrics=entities[first : first + MOST_METRICS])


def _check_database(uri: str, database: Path) -> None:
    """Refuse a file that is no database, that of another program, and a place where none can be made.

    Raises:
        InputError: It is one of these; nothing in it was changed.
    """
    whose = "is there is no SQLite file"
    try:
        if not os.path.lexists(database):
            _check_folder(uri, database.parent)
            return
        if database.is_file():
            with database.open("rb") as file:
                beginning = file.read(len(SQLITE_HEADER))
            if not beginning or (beginning == SQLITE_HEADER and _tables(database) >= TABLES):
                return
            whose = "is there is the database of another program" if beginning == SQLITE_HEADER else whose
    except DatabaseError as error:
        hint = f"another program has had it locked for {ANSWER_S} s: the same command again tries once more"
        raise InputError("tracking.uri", uri, "a file that can be used", hint) from error
    except OSError as error:
        hint = getattr(error, "strerror", None) or str(error)
        raise InputError("tracking.uri", uri, "a file that can be used", hint) from error
    raise InputError("tracking.uri", uri, ALLOWED, f"what {whose}, and is left alone")


def _check_folder(uri: str, folder: Path) -> None:
    """A folder that is missing is made once there is something to tell."""
    there = next(place for place in (folder, *folder.parents) if place.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        hint = "nothing may be written there" if there.is_dir() else "that is no folder"
        raise InputError("tracking.uri", uri, "a file that can be used", f"{there}: {hint}")


def _tables(database: Path) -> set[str]:
    """Names of its tables; none where it is damaged.

    Raises:
        DatabaseError: Another program has it locked.
    """
    try:
        with closing(connect(f"{database.as_uri()}?mode=ro", uri=True, timeout=ANSWER_S)) as connection:
            return {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    except DatabaseError as error:
        if getattr(error, "sqlite_errorcode", None) == SQLITE_BUSY:
            raise
        return set()


def _check_server(uri: str) -> None:
    """Refuse a server where nothing answers.

    Raises:
        InputError: Nothing does.
    """
    address = _address(uri)
    if address is None or urlsplit(uri).scheme in getproxies():
        return
    try:
        socket.create_connection(address, timeout=ANSWER_S).close()
    except (OSError, UnicodeError) as error:
        hint = f"nothing answers there ({getattr(error, 'strerror', None) or error})"
        raise InputError("tracking.uri", uri, "a server that runs", hint) from error


def _address(uri: str) -> tuple[str, int] | None:
    """Host and port of a server; None where there is none."""
    try:
        parts = urlsplit(uri)
        port = parts.port
    except ValueError:  # no port is above 65535
        return None
    if parts.scheme not in SERVERS or not parts.hostname:
        return None
    return parts.hostname, port or (443 if parts.scheme == "https" else 80)
