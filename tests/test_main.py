"""Whole runs of the real program, small: what they leave behind, and that the same seed gives the same bytes."""

import io
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calls import MEASURED, SMALL, Outcome, PinnRun
from interrupted_runs import without_figures
from small_problems import measured, small_chain
from sweeps import start

from pinn_cli.cli.command_line import Terminal
from pinn_cli.cli.job import shown
from pinn_cli.report import run_report
from pinn_cli.runs.stages import Stages
from pinn_cli.verdict.finding import Finding, Verdict

TABLES = [f"{name}.csv" for name in ("fitness", "modes", "drift", "energy", "free_run", "parameters", "residuals")]
FILES = {*TABLES, "history.csv"}
FILES |= {"response.nc", "run.json", "model.npz", "figures", ".hydra", "pinn-run.log", "report.html"}
LABELS = ["case", "estimator", "scheme", "ndof", "nonlinearity", "model_error", "snr_db", "seed"]


@pytest.fixture(scope="module")
def small_run(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """One run in a process of its own, as a user starts it."""
    process = start(tmp_path_factory.mktemp("run"), *SMALL, "case=small", "seed=0")
    out, err = process.communicate()
    return Outcome(process.returncode, out, err).done()


def test_a_run_leaves_every_file(small_run: Outcome) -> None:
    assert small_run.directory.parts[-3:-1] == ("outputs", "small")
    assert {entry.name for entry in small_run.directory.iterdir()} == FILES
    drawn = {figure.name for figure in (small_run.directory / "figures").iterdir()}
    assert {"response.png", "response.pdf", "error_map.png", "history.png"} <= drawn
    assert max(map(len, small_run.out.splitlines()[:-1])) <= 100


def test_the_log_tells_the_stages(small_run: Outcome) -> None:
    lines = (small_run.directory / "pinn-run.log").read_text().splitlines()
    assert all("[pinn_cli." in line for line in lines)
    assert any("estimate:" in line for line in lines)


def test_the_fitness_table(small_run: Outcome) -> None:
    fitness = pd.read_csv(small_run.directory / "fitness.csv")
    assert list(fitness.columns) == [*LABELS, "group", "quantity", "fitness_percent", "range_fitness_percent"]
    assert set(fitness["group"]) == {"all", "first", "last", "observed", "unobserved", "dof_1", "dof_2", "dof_3"}
    assert set(fitness["seed"]) == {0}


def test_the_record_of_a_run_says_what_made_it(small_run: Outcome) -> None:
    record = small_run.record
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


def test_the_response_is_labelled(small_run: Outcome) -> None:
    with xr.open_dataset(small_run.directory / "response.nc") as response:
        assert dict(response.sizes) == {"time": 256, "dof": 3, "connection": 3}
        assert response["dof"].values.tolist() == [1, 2, 3]
        for quantity in ("displacement", "velocity", "acceleration", "force"):
            for suffix in ("", "_std", "_true", "_observed"):
                assert response[quantity + suffix].attrs["units"]


def test_the_free_run(small_run: Outcome) -> None:
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


def test_a_record_whose_forces_are_all_unknown(small_run: Outcome, pinn_run: PinnRun, tmp_path: Path) -> None:
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


DOUBT = Verdict.of([Finding("gain", "acceleration of DOF 3", "the acceleration of DOF 3 is 1.15 times too large")])
QUICK = (*SMALL, "figures=false")


@pytest.fixture
def doubted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_report, "judge", lambda *_: DOUBT)


def test_the_verdict_is_told_and_status_4_where_it_is_strict(pinn_run: PinnRun, doubted: None) -> None:
    """In the line before the directory and in run.json."""
    done = pinn_run(*QUICK, "strict=true")
    assert done.status == 4
    assert done.out.splitlines()[-3:-1] == [f"- {DOUBT.reasons[0].text}", "verdict: questionable"]
    record = done.record
    assert (record["verdict"], record["reasons"]) == ("questionable", [DOUBT.reasons[0].text])
    assert done.err.splitlines()[-1].startswith("pinn-run: the verdict is questionable, and strict=true: the accel")
    assert (done.directory / "fitness.csv").is_file()
    again = pinn_run(f"resume={done.directory}")
    assert (again.status, again.out.splitlines()[0]) == (4, "finished before, nothing to do")
    assert pinn_run(f"resume={done.directory}", "strict=false").status == 0


def test_a_sound_run_passes_and_the_same_seed_gives_the_same_bytes(
    small_run: Outcome, pinn_run: PinnRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_report, "judge", lambda *_: Verdict.of([]))
    done = pinn_run(*QUICK, "case=small", "seed=0", "strict=true")
    assert (done.status, done.out.splitlines()[-2]) == (0, "verdict: sound")
    for name in TABLES:
        assert (small_run.directory / name).read_bytes() == (done.directory / name).read_bytes()


@pytest.mark.slow
def test_in_a_sweep_a_job_that_is_not_sound_failed(pinn_run: PinnRun, doubted: None, tmp_path: Path) -> None:
    command = ("--multirun", *QUICK, "seed=0,1", "strict=true")
    done = pinn_run(*command)
    assert done.status == 4
    jobs = pd.read_csv(done.directory / "jobs.csv")
    assert list(jobs["status"]) == ["failed", "failed"]
    assert all("1.15 times too large" in reason for reason in jobs["reason"])
    assert all((done.directory / name / "fitness.csv").is_file() for name in jobs["directory"])
    written = [(done.directory / name / "run.json").stat().st_mtime_ns for name in jobs["directory"]]
    assert pinn_run(*command).status == 4  # told again, and not run again
    assert written == [(done.directory / name / "run.json").stat().st_mtime_ns for name in jobs["directory"]]


def test_no_boolean_is_refused(pinn_run: PinnRun) -> None:
    done = pinn_run("strict=perhaps")
    assert (done.status, "true or false" in done.err) == (2, True)


OWN = ("parameters.csv", "fitness.csv", "residuals.csv", "modes.csv", "free_run.csv")
RIG = (
    "system=linear", "system.ndof=3", "system.m=10", "system.c=1", "data=csv", "data.path=rig.csv", "data.time=t",
    "data.force={1: f}", "data.acceleration={1: a1, 3: a3}", "scheme=state_parameter", "scheme.unknown=[k_*]",
    "scheme.starts=1", "threads=1", "figures=false",
)  # fmt: skip


def test_what_the_estimator_does_not_see(pinn_run: PinnRun, monkeypatch: pytest.MonkeyPatch) -> None:
    without_figures(monkeypatch)
    structure = small_chain("linear")
    record = measured(structure, snr_db=40.0, duration=20.0, samples=401).record
    columns = {"t": record.time, "f": record.force[:, 0], **{f"a{i}": record.acceleration[:, i - 1] for i in (1, 2, 3)}}
    table = pd.DataFrame(columns)
    table.to_csv("rig.csv", index=False)
    outcome = pinn_run(*RIG, "data.validation={start: 15}").done()
    found = pd.read_csv(outcome.directory / "validation.csv")
    assert found["dof"].tolist() == [1, 3]
    assert (found["nmse_percent"] < 1.0).all()
    assert found["inside_95_percent"].between(85.0, 100.0).all()
    assert "validation data" in outcome.out
    ruined = table.copy()
    ruined.loc[ruined["t"] >= 15.0, ["a1", "a3"]] = np.random.default_rng(0).standard_normal((101, 2))
    ruined.to_csv("rig.csv", index=False)
    again = pinn_run(*RIG, "data.validation={start: 15}", "figures=true")
    for name in OWN:
        assert (again.directory / name).read_bytes() == (outcome.directory / name).read_bytes(), name
    missed = pd.read_csv(again.directory / "validation.csv")["nmse_percent"]
    assert (missed > 50.0).all()
    _, page = (again.directory / "report.html").read_text(encoding="utf-8").split("Validation on other data")
    assert all(f"<td>{value:.3g}</td>" in page for value in missed)


def test_a_segment_that_was_seen_is_refused(pinn_run: PinnRun) -> None:
    table = pd.DataFrame({"t": 0.1 * np.arange(200), "f": 1.0, "a1": 0.0, "a3": 0.0})
    table.to_csv("rig.csv", index=False)
    pinn_run(*RIG, "data.validation={start: 5, stop: 8}", "data.stop=10").refused("outside of what the estimator sees")


STATE_PARAMETER = (*SMALL, "scheme=state_parameter", "scheme.unobserved=[2]")


def test_a_run_leaves_what_was_unknown_and_what_was_found(pinn_run: PinnRun) -> None:
    outcome = pinn_run(*STATE_PARAMETER, "scheme.initial={k_2: 5}", "figures=false").done()
    table = outcome.parameters
    assert set(table["scheme"]) == {"state_parameter"}
    assert list(table.index) == [f"{kind}_{dof}" for kind in ("c", "k", "kappa") for dof in (1, 2, 3)]
    assert table.loc[["k_2", "kappa_2"], "true"].tolist() == [15.0, 100.0]
    # The linear chain that comes nearest to the record takes the place of the stiffness that was given.
    assert 0.1 * 15.0 < table.loc["k_2", "start"] < 10.0 * 15.0
    assert table.loc["kappa_2", "start"] == 0.0
    assert table.loc["k_1", "prescribed"] == 15.0
    assert (table["start"].isna() != table["prescribed"].isna()).all()
    assert table.drop(columns=["start", "prescribed"]).notna().all(axis=None)
    assert np.all(table["lower_90"] < table["estimate"])
    assert np.all(table["estimate"] < table["upper_90"])
    for name, share in (("k_2", 0.01), ("kappa_2", 0.3)):
        row = table.loc[name]
        assert abs(row["estimate"] - row["true"]) < 3.0 * row["std"]
        assert 0.0 < row["std"] < share * row["true"]
        assert row["error_percent"] == pytest.approx(100.0 * abs(row["estimate"] / row["true"] - 1.0))
    fitness = pd.read_csv(outcome.directory / "fitness.csv").set_index(["group", "quantity"])["fitness_percent"]
    assert fitness["dof_2", "displacement"] > 98.0
    correlation = pd.read_csv(outcome.directory / "correlation.csv", index_col="parameter")
    assert list(correlation) == list(correlation.index) == list(table.index)
    assert "kappa_2 *" in outcome.out


RECORD = ("simulation.duration=12", "simulation.samples=256", "excitation.band=[0.2,1.5]", "figures=false")
RENAMED = {f"{kind}_{i}": f"{kind}_spring_{i}" for kind in ("c", "k", "kappa") for i in (1, 2, 3)}


def written_chain(law: str, **parameters: float) -> list[str]:
    """Overrides for a chain of three masses, written out."""
    ends = ["ground", "x1", "x2", "x3"]
    values = ", ".join(f"{name}: {value}" for name, value in {"c": 1.0, "k": 15.0, **parameters}.items())
    springs = [
        f"spring_{i}: {{between: [{ends[i - 1]}, {ends[i]}], law: {law}, {values}}}" for i in range(1, len(ends))
    ]
    connections = f"system.connections={{{', '.join(springs)}}}"
    return ["system=structure", "system.dofs=[x1,x2,x3]", "system.mass=10", connections]


@pytest.mark.slow  # system/test_topology.py compares their parameters and connections
@pytest.mark.parametrize(
    "settings",
    [
        ["scheme=sparse_recovery"],
        ["scheme=state_parameter", "scheme.unobserved=[2]"],
        ["scheme=sparse_recovery", "model_error=perturbed"],
        ["scheme=sparse_recovery", "model_error=linear"],
    ],
    ids=["recovery", "state_parameter", "perturbed", "linear"],
)
def test_a_chain_written_out_gives_the_chain_s_numbers(pinn_run: PinnRun, settings: list[str]) -> None:
    chain = pinn_run("system=duffing", "system.ndof=3", *RECORD, *settings)
    written = pinn_run(*written_chain("duffing", kappa=100.0), *RECORD, *settings)
    assert (chain.status, written.status) == (0, 0), written.err
    for table in ("fitness.csv", "parameters.csv", "residuals.csv"):
        expected, found = (pd.read_csv(run.directory / table) for run in (chain, written))
        if "parameter" in expected:
            expected["parameter"] = expected["parameter"].map(RENAMED)
        if "channel" in expected:
            expected["channel"] = expected["channel"].str.replace("DOF ", "DOF x")
        pd.testing.assert_frame_equal(expected, found, rtol=1e-10, atol=1e-13)
    with (
        xr.open_dataset(chain.directory / "response.nc") as expected,
        xr.open_dataset(written.directory / "response.nc") as found,
    ):
        assert set(expected.data_vars) == set(found.data_vars)
        for name in expected.data_vars:
            size = np.nanmax(np.abs(expected[name]), initial=0.0)
            np.testing.assert_allclose(found[name], expected[name], rtol=1e-10, atol=1e-10 * size)


def test_a_structure_that_nobody_has_written_down_is_one_line(pinn_run: PinnRun) -> None:
    pinn_run("system=structure").refused("system.dofs=[]: must be a list of names of coordinates")


def test_a_setting_of_chains_is_none_of_a_structure(pinn_run: PinnRun) -> None:
    pinn_run(*written_chain("linear"), "system.ndof=3").refused("system.ndof")
