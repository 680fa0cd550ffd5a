"""Runs in MLflow's SQLite store: what is there, going on, failing, and several processes at once."""

import contextlib
import os
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from calls import SMALL, PinnRun
from interrupted_runs import contents, in_a_child, without_figures
from sweeps import mlflow_runs

from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.sweep.tracking import mlflow as mlflow_tracking
from pinn_cli.sweep.tracking.mlflow import MlflowTracking
from pinn_cli.sweep.tracking.tracking import TrackedRun, follow

pytest.importorskip("mlflow", reason="the extra mlflow is not installed")
pytest.importorskip("sqlalchemy", reason="the extra mlflow is not installed")

from mlflow.tracking import MlflowClient

PROCESSES = 4
# A run that is no run: what MLflow sees of one, many times over.
ONE_PROCESS = """
import sys
from pathlib import Path
from pinn_cli.sweep.tracking.tracking import TrackedRun, follow
from pinn_cli.sweep.tracking.mlflow import MlflowTracking
for number in range(3):
    place = Path(sys.argv[1], str(number))
    place.mkdir(parents=True)
    job = TrackedRun(place, place.parent.name, {"seed": str(number)}, {"case": "many"}, "many")
    with follow(MlflowTracking("sqlite:///shared.db"), job, resuming=False) as tracked:
        for iteration in range(1, 40):
            tracked.row({"iteration": iteration, "seconds": 0.1, "loss_physics": 1.0 / iteration})
"""


def steps_of(database: Path, run: Any, metric: str) -> list[int]:
    client = MlflowClient(tracking_uri=f"sqlite:///{database}")
    return [m.step for m in client.get_metric_history(run.info.run_id, metric)]


def killed(*_: object, **__: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.slow
def test_a_run_that_was_killed_while_it_was_told_is_one_run_in_the_end(tmp_path: Path) -> None:
    """In each of the steps: when the tables are made, when the run is, when it is told, when it is told anew."""
    import mlflow.tracking  # noqa: F401 once, rather than in each child

    directory, database = tmp_path / "run", tmp_path / "mlflow.db"
    directory.mkdir()
    (tmp_path / ".mlflow.db.new").write_bytes(b"half of the tables")
    job = TrackedRun(directory, "run", {"seed": "0", "threads": "1"}, {"case": "killed"}, "of these settings")

    def start(place: Any, step: str, resuming: bool = True) -> None:
        if step:
            setattr(place, step, killed)
        with follow(MlflowTracking(f"sqlite:///{database}"), job, resuming) as tracked:
            for iteration in range(1, 9):
                tracked.row({"iteration": iteration, "seconds": 0.1 * iteration, "loss_physics": 1.0 / iteration})

    assert in_a_child(lambda: start(mlflow_tracking, "replacing")) == -signal.SIGKILL
    assert not database.exists()
    for step in ("create_run", "log_batch", "delete_run"):
        assert in_a_child(lambda step=step: start(MlflowClient, step)) == -signal.SIGKILL  # type: ignore[misc]
    (half,) = mlflow_runs(database)
    assert half.info.status == "KILLED"
    assert in_a_child(lambda: start(None, "")) == 0
    (run,) = mlflow_runs(database)
    assert run.info.status == "FINISHED"
    assert steps_of(database, run, "loss_physics") == list(range(1, 9))
    assert run.data.params == {"seed": "0", "threads": "1"}
    assert {file.name for file in tmp_path.iterdir()} == {"mlflow.db", "run"}


@pytest.mark.slow
def test_a_finished_run_is_told_afterwards(pinn_run: PinnRun, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """One that was not tracked, or was killed between its last file and the tracker's last call; and only once."""
    without_figures(monkeypatch)
    assert pinn_run(*SMALL, "hydra.run.dir=run").status == 0
    before = {file: file.read_bytes() for file in (tmp_path / "run").glob("*.csv")}
    outcome = pinn_run("resume=run", "tracking=mlflow", "tracking.uri=sqlite:///here.db").done()
    assert outcome.out.startswith("finished before; tracking=mlflow has it now\n")
    again = pinn_run(*SMALL, "hydra.run.dir=run", "resume=auto", "tracking=mlflow", "tracking.uri=sqlite:///here.db")
    assert again.out.startswith("finished before, nothing to do\n")
    assert before == {file: file.read_bytes() for file in (tmp_path / "run").glob("*.csv")}
    (run,) = mlflow_runs(tmp_path / "here.db")
    assert run.info.status == "FINISHED"
    history = pd.read_csv(tmp_path / "run" / "history.csv")
    assert steps_of(tmp_path / "here.db", run, "seconds") == history["iteration"].tolist()
    assert {"fitness_percent/velocity", "error_percent/k_1"} <= set(run.data.metrics)
    assert (tmp_path / "here-artifacts" / run.info.run_id / "artifacts" / "response.nc").is_file()


def test_a_diverging_run_has_failed_with_its_history(tmp_path: Path) -> None:
    job = TrackedRun(tmp_path, "run", {"seed": "0"}, {}, "")
    tracking = MlflowTracking(f"sqlite:///{tmp_path / 'here.db'}")
    with contextlib.suppress(DivergenceError), follow(tracking, job, resuming=False) as tracked:
        tracked.row({"iteration": 6, "seconds": 0.1, "loss_physics": 1e300})
        raise DivergenceError("diverged at iteration 7")
    (run,) = mlflow_runs(tmp_path / "here.db")
    assert (run.info.status, run.data.tags["status"]) == ("FAILED", "failed")
    assert run.data.tags["reason"] == "diverged at iteration 7"
    assert steps_of(tmp_path / "here.db", run, "loss_physics") == [6]


@pytest.mark.slow
def test_several_processes_share_one_file(tmp_path: Path) -> None:
    """From the first moment on, when the tables are made."""
    command = [sys.executable, "-c", ONE_PROCESS]
    started = [
        subprocess.Popen([*command, f"process_{i}"], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
        for i in range(PROCESSES)
    ]
    for process in started:
        told = process.communicate(timeout=500)[1]
        assert process.returncode == 0, told
        assert "the run goes on" not in told
    found = mlflow_runs(tmp_path / "shared.db")
    assert len(found) == 3 * PROCESSES
    assert {run.info.status for run in found} == {"FINISHED"}
    for run in found:
        assert steps_of(tmp_path / "shared.db", run, "loss_physics") == list(range(1, 40))


@pytest.mark.parametrize(
    "setting",
    [
        *({"uri": uri} for uri in (5, "", "runs", "ftp://here", "databricks", "postgresql://here/runs", "file:/x")),
        *({"uri": uri} for uri in ("sqlite://", "sqlite:///", "http://", "http://here:99999", "http://[")),
        {"experiment": ""},
        {"files": "yes"},
        *({"artifacts": folder} for folder in (5, "", ["a"])),
    ],
)
def test_impossible_settings_are_named(setting: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"tracking.{next(iter(setting))}"):
        MlflowTracking(**setting)


def told(uri: str, directory: Path) -> str:
    """What a store that cannot be used says, and in how few seconds."""
    begun = time.monotonic()
    job = TrackedRun(directory, "run", {}, {}, "")
    with pytest.raises(InputError) as error, follow(MlflowTracking(uri), job, resuming=False):
        pass
    assert time.monotonic() - begun < 30.0
    assert list(directory.glob("tracking.json")) == []
    return str(error.value)


@pytest.mark.slow
def test_a_server_that_takes_calls_and_says_nothing_does_the_run_no_harm(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_TIMEOUT", "1")
    job = TrackedRun(tmp_path, "run", {}, {}, "")
    with socket.create_server(("127.0.0.1", 0)) as server:
        tracking = MlflowTracking(f"http://127.0.0.1:{server.getsockname()[1]}")
        with follow(tracking, job, resuming=False) as tracked:
            tracked.row({"iteration": 1})
    assert [record.message.partition(":")[0] for record in caplog.records] == ["tracking=mlflow"]
    assert os.environ["MLFLOW_HTTP_REQUEST_MAX_RETRIES"] == "1"


@pytest.mark.parametrize(
    ("uri", "reason"),
    [
        ("sqlite:///rig.csv", "what is there cannot be used: file is not a database"),
        ("sqlite:///folder", "what is there is no file"),
        ("sqlite:///pipe", "what is there is no file"),
        ("sqlite:///notes.db", "what is there is the database of another program, and is left alone"),
        ("sqlite:///runs.db", "what is there is the database of another program, and is left alone"),
        ("sqlite:///none.db", "what is there is the database of another program, and is left alone"),
        ("sqlite:///rig.csv/mlflow.db", "rig.csv: nothing may be written there"),
        ("http://127.0.0.1:{port}", "Connection refused)"),
    ],
)
def test_a_store_that_cannot_be_used_is_left_alone(tmp_path: Path, uri: str, reason: str, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.csv").write_text("t,f\n0,1\n")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    tables = {"notes": "notes (text)", "runs": "runs (id); CREATE TABLE alembic_version (version_num)"}
    for name, made in (tables | {"none": ""}).items():
        with contextlib.closing(sqlite3.connect(f"{name}.db")) as connection:
            connection.executescript(f"CREATE TABLE {made}" if made else "PRAGMA user_version = 7")
    with socket.create_server(("127.0.0.1", 0)) as server:
        uri = uri.format(port=server.getsockname()[1])
    before = contents(tmp_path), sorted(tmp_path.iterdir())
    assert told(uri, tmp_path).endswith(reason)
    assert before == (contents(tmp_path), sorted(tmp_path.iterdir()))


def test_a_database_that_another_program_has_locked_is_no_other_program_s(tmp_path: Path, monkeypatch) -> None:
    database = tmp_path / "here.db"
    monkeypatch.setattr(mlflow_tracking, "ANSWER_S", 0.1)
    with contextlib.closing(sqlite3.connect(database, isolation_level=None)) as connection:
        connection.executescript("CREATE TABLE notes (text); BEGIN EXCLUSIVE")
        assert "cannot be used: database is locked" in told(f"sqlite:///{database}", tmp_path)
        connection.execute("ROLLBACK")
    assert "the database of another program" in told(f"sqlite:///{database}", tmp_path)
