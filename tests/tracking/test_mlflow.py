"""Runs in MLflow's SQLite store: what is there, going on, failing, and several processes at once."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from calls import SMALL, PinnRun
from interrupted_runs import ADAM, Steps, without_figures

from pinn_cli.errors import InputError

pytest.importorskip("mlflow", reason="the extra mlflow is not installed")
pytest.importorskip("sqlalchemy", reason="the extra mlflow is not installed")

PROCESSES = 4
# A run that is no run: what MLflow sees of one, many times over.
ONE_PROCESS = """
import sys
from pathlib import Path
from pinn_cli.tracking.base import Job
from pinn_cli.tracking.follow import follow
from pinn_cli.tracking.mlflow import MlflowTracking
for number in range(3):
    place = Path(sys.argv[1], str(number))
    place.mkdir(parents=True)
    job = Job(place, place.parent.name, {"seed": str(number)}, {"case": "many"})
    with follow(MlflowTracking("sqlite:///shared.db"), job, resuming=False) as tracked:
        for iteration in range(1, 40):
            tracked.row({"iteration": iteration, "loss_physics": 1.0 / iteration})
            tracked.flush()
"""


def runs(database: Path) -> list[Any]:
    from mlflow.tracking import MlflowClient

    client = MlflowClient(tracking_uri=f"sqlite:///{database}")
    return list(client.search_runs([e.experiment_id for e in client.search_experiments()]))


def steps_of(database: Path, run: Any, metric: str) -> list[int]:
    from mlflow.tracking import MlflowClient

    return [
        m.step for m in MlflowClient(tracking_uri=f"sqlite:///{database}").get_metric_history(run.info.run_id, metric)
    ]


def test_an_interrupted_run_is_one_run_in_the_end(
    pinn_run: PinnRun, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    without_figures(monkeypatch)
    steps, database = Steps(monkeypatch), tmp_path / "outputs" / "mlflow.db"
    steps.signal_at(10, signal.SIGINT)
    assert pinn_run(*ADAM, "tracking=mlflow", "hydra.run.dir=run").status == 130
    (run,) = runs(database)
    assert (run.info.status, run.data.tags["reason"]) == ("KILLED", "SIGINT")
    steps.undisturbed()
    outcome = pinn_run("resume=run")
    assert outcome.status == 0, outcome.err
    (run,) = runs(database)
    assert (run.info.status, run.data.tags["status"], run.data.tags["case"]) == ("FINISHED", "finished", "default")
    history = pd.read_csv(tmp_path / "run" / "history.csv")
    assert steps_of(database, run, "loss_observation") == history["iteration"].tolist()
    assert run.data.params["system.ndof"] == "3"
    fitness = pd.read_csv(tmp_path / "run" / "fitness.csv").set_index(["group", "quantity"])["fitness_percent"]
    assert run.data.metrics["fitness_percent/displacement"] == pytest.approx(fitness["all", "displacement"])
    copied = tmp_path / "outputs" / "mlflow-artifacts" / run.info.run_id / "artifacts"
    assert (copied / "fitness.csv").read_bytes() == (tmp_path / "run" / "fitness.csv").read_bytes()
    assert not (copied / "checkpoint.pt").exists()


def test_a_diverging_run_has_failed(pinn_run: PinnRun, tmp_path: Path) -> None:
    settings = ["training.learning_rate=1e30", "tracking=mlflow", "tracking.uri=sqlite:///here.db"]
    assert pinn_run(*ADAM, *settings).status == 3
    (run,) = runs(tmp_path / "here.db")
    assert (run.info.status, run.data.tags["status"]) == ("FAILED", "failed")
    assert "iteration" in run.data.tags["reason"]


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
    found = runs(tmp_path / "shared.db")
    assert len(found) == 3 * PROCESSES
    assert {run.info.status for run in found} == {"FINISHED"}
    for run in found:
        assert steps_of(tmp_path / "shared.db", run, "loss_physics") == list(range(1, 40))


def test_an_unusable_store_is_told_before_anything_runs(pinn_run: PinnRun, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    outcome = pinn_run(*SMALL, "tracking=mlflow", "tracking.uri=sqlite:///file/mlflow.db")
    assert outcome.status == 2
    assert outcome.err.startswith("pinn-run: tracking.uri=")
    assert outcome.err.count("\n") == 1
    assert not (tmp_path / "outputs").exists()


@pytest.mark.parametrize("setting", [{"uri": 5}, {"experiment": ""}, {"files": "yes"}])
def test_impossible_settings_are_named(setting: dict[str, Any]) -> None:
    from pinn_cli.tracking.mlflow import MlflowTracking

    with pytest.raises(InputError, match=f"tracking.{next(iter(setting))}"):
        MlflowTracking(**setting)


def test_it_is_imported_only_where_it_is_chosen(tmp_path: Path) -> None:
    code = "import sys; from pinn_cli.main import run; import pinn_cli.tracking.follow; print('mlflow' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
