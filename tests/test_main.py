"""Whole runs of the real program, small: what they leave behind, and that the same seed gives the same bytes."""

import io
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import pytest
import xarray as xr
from calls import MEASURED, SMALL, PinnRun

from pinn_cli.cli.command_line import Terminal
from pinn_cli.cli.job import shown
from pinn_cli.runs.stages import Stages

TABLES = [f"{name}.csv" for name in ("fitness", "modes", "drift", "energy", "free_run", "parameters", "residuals")]
FILES = {*TABLES, "history.csv"}
FILES |= {"response.nc", "run.json", "model.npz", "figures", ".hydra", "pinn-run.log", "report.html"}
LABELS = ["case", "estimator", "scheme", "ndof", "nonlinearity", "model_error", "snr_db", "seed"]


@dataclass(frozen=True)
class FinishedRun:
    out: str
    directory: Path


@pytest.fixture(scope="module")
def small_run(tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    """One run in a process of its own, as a user starts it."""
    command = [sys.executable, "-m", "pinn_cli.main", *SMALL, "case=small", "seed=0"]
    done = subprocess.run(command, cwd=tmp_path_factory.mktemp("run"), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return FinishedRun(done.stdout, Path(done.stdout.splitlines()[-1]))


def test_a_run_leaves_every_file(small_run: FinishedRun) -> None:
    assert small_run.directory.parts[-3:-1] == ("outputs", "small")
    assert {entry.name for entry in small_run.directory.iterdir()} == FILES
    drawn = {figure.name for figure in (small_run.directory / "figures").iterdir()}
    assert {"response.png", "response.pdf", "error_map.png", "history.png"} <= drawn
    assert max(map(len, small_run.out.splitlines()[:-1])) <= 100


def test_the_log_tells_the_stages(small_run: FinishedRun) -> None:
    lines = (small_run.directory / "pinn-run.log").read_text().splitlines()
    assert all("[pinn_cli." in line for line in lines)
    assert any("estimate:" in line for line in lines)


def test_the_fitness_table(small_run: FinishedRun) -> None:
    fitness = pd.read_csv(small_run.directory / "fitness.csv")
    assert list(fitness.columns) == [*LABELS, "group", "quantity", "fitness_percent", "range_fitness_percent"]
    assert set(fitness["group"]) == {"all", "first", "last", "observed", "unobserved", "dof_1", "dof_2", "dof_3"}
    assert set(fitness["seed"]) == {0}


def test_the_record_of_a_run_says_what_made_it(small_run: FinishedRun) -> None:
    record = json.loads((small_run.directory / "run.json").read_text())
    assert (record["seed"], record["device"], record["threads"]) == (0, "cpu", 1)
    stages = record["seconds"]
    assert 0.0 < stages["start_up"] < stages["table_at"] <= stages["total"] - stages["figures"]
    assert stages.pop("processor") > 0.0
    stages.pop("table_at")
    expected = {"config", "imports", "system", "record", "problem", "estimate", "report", "figures", "total"}
    assert expected <= set(stages)
    assert sum(stages.values()) - stages["total"] == pytest.approx(stages["total"], rel=0.2)
    assert record["training"]["iterations"] >= 1
    assert record["training"]["stop_reason"]
    assert record["peak_memory_mib"]["process"] > 50
    assert record["versions"]["torch"]
    assert record["command"][1:] == [*SMALL, "case=small", "seed=0"]


def test_a_reader_that_leaves_costs_no_result(monkeypatch: pytest.MonkeyPatch) -> None:
    class Left(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError

    stages, written = Stages(), False
    monkeypatch.setattr(sys, "stdout", Left())
    with pytest.raises(BrokenPipeError), shown(lambda: "table", stages, Terminal()):
        written = True
    assert written
    assert "table_at" in stages.seconds


def test_the_response_is_labelled(small_run: FinishedRun) -> None:
    with xr.open_dataset(small_run.directory / "response.nc") as response:
        assert dict(response.sizes) == {"time": 256, "dof": 3, "connection": 3}
        assert response["dof"].values.tolist() == [1, 2, 3]
        for quantity in ("displacement", "velocity", "acceleration", "force"):
            for suffix in ("", "_std", "_true", "_observed"):
                assert response[quantity + suffix].attrs["units"]


def test_the_free_run(small_run: FinishedRun) -> None:
    table, fitness = (pd.read_csv(small_run.directory / f"{name}.csv") for name in ("free_run", "fitness"))
    assert list(table) == [*LABELS, "against", *fitness.columns[len(LABELS) :]]
    assert set(table["estimator"]) == {"free_run"}
    scores = table.set_index(["against", "group", "quantity"])["fitness_percent"]
    assert scores["estimate", "all", "displacement"] > 99.0
    assert scores["truth", "all", "displacement"] > 98.0
    assert "\nfree run: " in small_run.out
    with xr.open_dataset(small_run.directory / "response.nc") as response:
        difference = response["displacement_free_run"] - response["displacement"]
        assert 0.0 < float(abs(difference).max()) < 0.01 * float(abs(response["displacement"]).max())


def test_the_same_seed_gives_the_same_bytes(small_run: FinishedRun, pinn_run: PinnRun) -> None:
    again = pinn_run(*SMALL, "case=small", "seed=0", "figures=false").directory
    for name in TABLES:
        assert (small_run.directory / name).read_bytes() == (again / name).read_bytes()


def test_a_sweep_joins_its_tables(pinn_run: PinnRun) -> None:
    outcome = pinn_run("--multirun", *SMALL, "figures=false", "noise.snr_db=40,30").done()
    for name in TABLES:
        joined = pd.read_csv(outcome.directory / name)
        assert joined.columns[0] == "noise.snr_db"
        joined = joined.drop(columns=["status", "reason"], errors="ignore")
        assert "system.ndof" not in joined  # given, but not swept
        assert joined["noise.snr_db"].drop_duplicates().tolist() == [40, 30]
        jobs = [next(outcome.directory.glob(f"noise.snr_db={snr}_*")) for snr in (40, 30)]
        single = [pd.read_csv(job / name) for job in jobs]
        pd.testing.assert_frame_equal(joined.drop(columns="noise.snr_db"), pd.concat(single, ignore_index=True))


def test_a_baseline_is_compared_with(pinn_run: PinnRun) -> None:
    outcome = pinn_run(*SMALL, "figures=false", "baseline=kalman_smoother").done()
    for name in ("fitness.csv", "parameters.csv"):
        estimators = pd.read_csv(outcome.directory / name)["estimator"]
        assert estimators.drop_duplicates().tolist() == ["pinn", "kalman_smoother"]
    record = outcome.record
    assert record["baseline"]["name"] == "kalman_smoother"
    assert record["seconds"]["baseline"] > 0
    with xr.open_dataset(outcome.directory / "response.nc") as response:
        assert "displacement_kalman_smoother_std" in response
    told, _, verdict = outcome.out.rpartition("\n\n")
    assert [line.split()[0] for line in told.splitlines()[-2:]] == ["pinn", "kalman_smoother"]
    assert verdict.splitlines()[-2].startswith("verdict: ")


def test_a_record_whose_forces_are_all_unknown(small_run: FinishedRun, pinn_run: PinnRun, tmp_path: Path) -> None:
    with xr.open_dataset(small_run.directory / "response.nc") as response:
        columns = {f"a{dof}": response["acceleration_true"].sel(dof=dof).values for dof in (1, 2, 3)}
        pd.DataFrame({"t": response["time"].values, **columns}).to_csv(tmp_path / "rig.csv", index=False)
    settings = ["data.force={1: null, 2: null, 3: null}", "data.acceleration={1: a1, 2: a2, 3: a3}"]
    structure = ["system.m=10", "system.c=1", "system.k=15", "system.kappa=100"]
    outcome = pinn_run(*MEASURED, "data=csv", "data.path=rig.csv", "figures=false", *settings, *structure).done()
    assert "the force on DOFs 1, 2, 3 is unknown, and a free run needs every force" in outcome.out
    table = pd.read_csv(outcome.directory / "free_run.csv")
    assert table[["fitness_percent", "range_fitness_percent"]].isna().all(axis=None)
    with xr.open_dataset(outcome.directory / "response.nc") as response:
        assert "displacement_free_run" not in response
