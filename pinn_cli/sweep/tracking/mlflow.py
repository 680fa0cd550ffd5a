"""Tracking with MLflow, which is told of a run once, when that has ended; by default a SQLite file, without a server.

What can be found out about a store without MLflow is found out before the run begins. MLflow itself would import
drivers by the name in a URI, make its tables in any database, and try a server that does not answer for minutes.
"""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from sqlite3 import DatabaseError, connect
from typing import TYPE_CHECKING
from urllib.parse import urlsplit
from urllib.request import getproxies

from pinn_cli.runs.claim import locked
from pinn_cli.runs.writing import replacing
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import located, true_or_false
from pinn_cli.sweep.tracking.tracking import (
    FAILED,
    FINISHED,
    INTERRUPTED,
    Outcome,
    TrackedRun,
    Tracker,
    Tracking,
    require,
)

if TYPE_CHECKING:
    from mlflow.tracking import MlflowClient

SQLITE, SERVERS = "sqlite:///", ("http", "https")
STORES_ALLOWED = "a SQLite file, sqlite:///FILE, or a server, http://HOST:PORT"
# Some of the tables that every store of MLflow has.
MLFLOW_TABLES = {"experiments", "runs", "metrics", "params", "tags", "alembic_version"}
# A server is waited for so long, s, for each of two tries, and a file that another program has locked; of a server what
# the user's environment says counts more.
ANSWER_S = 10
DEFAULTS = {
    "MLFLOW_HTTP_REQUEST_TIMEOUT": str(ANSWER_S),
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",
    "MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR": "1",
    "MLFLOW_LOGGING_LEVEL": "WARNING",
}
# A run that is being told is KILLED until all is told: should the process be killed, it does not run for ever.
MLFLOW_STATUS, HALF_TOLD = {FINISHED: "FINISHED", FAILED: "FAILED"}, "KILLED"
# Tag with the key that the run's directory has.
KEY = "key"
# What MLflow takes in one request, and how long a text may be.
MOST_METRICS, MOST_PARAMS, LONGEST_TEXT = 1000, 100, 500


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
        address: Host and port of the server; None for a file.

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
        given = uri if isinstance(uri, str) and uri.isprintable() else ""
        file = given.removeprefix(SQLITE) if given.startswith(SQLITE) else ""
        self.database = located(file, start) if file.strip(" /") else None
        self.address = _address(given)
        if self.database is None and self.address is None:
            raise InputError("tracking.uri", uri, STORES_ALLOWED)
        self.uri = uri if self.database is None else f"{SQLITE}{self.database}"
        if not isinstance(experiment, str) or not experiment.strip():
            raise InputError("tracking.experiment", experiment, "a text")
        self.experiment, self.files = experiment, true_or_false("tracking.files", files)
        if artifacts is not None and (not isinstance(artifacts, str) or not artifacts):
            raise InputError("tracking.artifacts", artifacts, "null or a folder")
        self.artifacts = None if artifacts is None else located(artifacts, start)
        if self.artifacts is None and self.database is not None:
            self.artifacts = self.database.with_name(f"{self.database.stem}-artifacts")

    def open(self, run: TrackedRun, key: str, before: str) -> MlflowTracker:
        """See :meth:`Tracking.open`."""
        if self.database is not None:
            _check_database(self.uri, self.database)
        elif self.address is not None:
            _check_server(self.uri, self.address)
        return MlflowTracker(self, run, key)

    @contextmanager
    def connected(self) -> Iterator[tuple[MlflowClient, str]]:
        """A client, and the number of the experiment; one process of ours at a time has a SQLite file."""
        with ExitStack() as held:
            if self.database is not None:
                self.database.parent.mkdir(parents=True, exist_ok=True)
                held.enter_context(locked(self.database.with_name(f".{self.database.name}.lock")))
                _check_database(self.uri, self.database)
                if not self.database.exists():
                    _make_tables(self.database)
            client = _client(self.uri)
            yield client, self._experiment(client)

    def _experiment(self, client: MlflowClient) -> str:
        experiment = client.get_experiment_by_name(self.experiment)
        if experiment is None:
            place = None if self.artifacts is None else self.artifacts.as_uri()
            try:
                return str(client.create_experiment(self.experiment, artifact_location=place))
            except Exception:  # another process was faster, on a server
                experiment = client.get_experiment_by_name(self.experiment)
                if experiment is None:
                    raise
        return str(experiment.experiment_id)


class MlflowTracker(Tracker):
    """One run of MLflow, made when the run has ended. One that was interrupted has not: it may go on."""

    def __init__(self, tracking: MlflowTracking, run: TrackedRun, key: str) -> None:
        self.tracking, self.run, self.key = tracking, run, key
        self._rows: list[Mapping[str, float]] = []

    def row(self, row: Mapping[str, float]) -> None:
        """See :meth:`Tracker.row`."""
        self._rows.append(dict(row))

    def end(self, status: str, reason: str, outcome: Outcome | None) -> None:
        """See :meth:`Tracker.end`. What a process that was killed meanwhile, or a part of the run has told goes."""
        if status == INTERRUPTED:
            return
        with self.tracking.connected() as (client, experiment):
            from mlflow.entities import Metric, Param

            everywhere = [other.experiment_id for other in client.search_experiments()]
            for before in client.search_runs(everywhere, f"tags.{KEY} = '{self.key}'"):
                client.delete_run(before.info.run_id)
            tags = {name: str(value) for name, value in self.run.labels.items()}
            end_tags = {"status": status, "reason": reason[:LONGEST_TEXT]}
            tags |= {"directory": str(self.run.directory), KEY: self.key, **end_tags}
            run = client.create_run(experiment, tags=tags, run_name=self.run.name).info.run_id
            client.set_terminated(run, HALF_TOLD)
            settings = {n.replace("[", ".").replace("]", ""): value for n, value in self.run.settings.items()}
            params = [Param(name, value[:LONGEST_TEXT]) for name, value in settings.items()]
            for first in range(0, len(params), MOST_PARAMS):
                client.log_batch(run, params=params[first : first + MOST_PARAMS])
            now, rows = int(1000 * time.time()), [(row, int(row["iteration"])) for row in self._rows]
            rows += [] if outcome is None else [(outcome.metrics, 0)]
            metrics = [Metric(n, float(v), now, step) for row, step in rows for n, v in row.items() if n != "iteration"]
            for first in range(0, len(metrics), MOST_METRICS):
                client.log_batch(run, metrics=metrics[first : first + MOST_METRICS])
            for file in outcome.files if outcome is not None and self.tracking.files else ():
                log, place = (client.log_artifacts, file.name) if file.is_dir() else (client.log_artifact, None)
                log(run, str(file), artifact_path=place)
            client.set_terminated(run, MLFLOW_STATUS[status])


def _client(uri: str) -> MlflowClient:
    # Read when MLflow is first imported. It is to tell nobody of its use, and us of trouble only.
    os.environ["MLFLOW_DISABLE_TELEMETRY"] = os.environ["DO_NOT_TRACK"] = "true"
    for name, value in DEFAULTS.items():
        os.environ.setdefault(name, value)
    logging.getLogger("alembic").setLevel(logging.WARNING)
    logging.getLogger("urllib3").setLevel(logging.ERROR)  # which tells each try
    logging.getLogger("mlflow.store.db.utils").setLevel(logging.CRITICAL)  # a traceback of what is raised anyway
    from mlflow.tracking import MlflowClient

    return MlflowClient(tracking_uri=uri)


def _make_tables(database: Path) -> None:
    """Make the database whole: MLflow does it in a thousand steps and cannot go on where it was killed in one."""
    draft = database.with_name(f".{database.name}.new")
    draft.unlink(missing_ok=True)
    _client(f"{SQLITE}{draft}")
    # Not renamed: MLflow has it open to the end of the process.
    with replacing(database) as whole, closing(connect(draft)) as made, closing(connect(whole)) as copy:
        made.backup(copy)
    draft.unlink()


def _check_database(uri: str, database: Path) -> None:
    """Refuse what is no database of MLflow's, is locked, or cannot be made; nothing is changed."""
    fault, folder = "", next(place for place in database.parents if place.exists())
    if not os.path.lexists(database):  # nor need its folder be there
        if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
            fault = f"{folder}: nothing may be written there"
    elif not database.is_file():
        fault = "what is there is no file"
    elif database.stat().st_size:  # one that was only just made is empty
        try:
            with closing(connect(f"{database.as_uri()}?mode=ro", uri=True, timeout=ANSWER_S)) as connection:
                listed = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
                if not {name for (name,) in listed} >= MLFLOW_TABLES:
                    fault = "what is there is the database of another program, and is left alone"
        except DatabaseError as error:
            fault = f"what is there cannot be used: {error}"
    if fault:
        raise InputError("tracking.uri", uri, STORES_ALLOWED, fault)


def _check_server(uri: str, address: tuple[str, int]) -> None:
    """Refuse a server where nothing answers."""
    if urlsplit(uri).scheme in getproxies():
        return
    try:
        socket.create_connection(address, timeout=ANSWER_S).close()
    except (OSError, UnicodeError) as error:
        raise InputError("tracking.uri", uri, "a server that runs", f"nothing answers there ({error})") from error


def _address(uri: str) -> tuple[str, int] | None:
    """Host and port of a server; None where there is none."""
    with suppress(ValueError):  # no port is above 65535
        parts = urlsplit(uri)
        if parts.scheme in SERVERS and parts.hostname:
            return parts.hostname, parts.port or (443 if parts.scheme == "https" else 80)
    return None
