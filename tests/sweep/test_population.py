"""`pinn-run population` and `pinn_cli.population`: finished runs in, tables, warnings and a figure out."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from structures import braced
from sweeps import made_sweep

from pinn_cli import InputError, population
from pinn_cli.model.file import write_model
from pinn_cli.model.knowledge import EndState, Levels, Misfit, Model, ParameterKnowledge

STIFFNESS = np.array([14.0, 15.0, 16.0, 15.5, 14.5, 15.2])


def left_behind(place, k, std=0.1, verdict="sound", kinds=("k", "m")):
    """A finished run that found the first two parameters of each kind, the first of them as given."""
    structure = braced()
    parameters = tuple(
        replace(structure.parameter(kind, i), prescribed=15.0, prior_std=150.0, unknown=True, positive=True)
        for kind in kinds
        for i in range(2)
    )
    count = len(parameters)
    mean, nothing = np.full(count, 15.0) + 0.01 * k, np.zeros(count)
    mean[0] = k
    found = ParameterKnowledge(mean, np.eye(count) * std**2, nothing, nothing, np.full(count, 150.0))
    end, misfit = EndState(1.0, np.zeros(6), np.eye(6), np.zeros((6, count))), Misfit.of(0.1, np.ones((9, 3)), 1.0, 0.0)
    levels = Levels({}, 0.0, 0.1, 1.0, 1.0)
    place.mkdir(parents=True, exist_ok=True)
    write_model(Model(structure, parameters, found, levels, end, verdict, "why", misfit=misfit), place)
    (place / "run.json").write_text(json.dumps({"configuration": "abc", "verdict": verdict}))
    return str(place)


@pytest.fixture
def runs(tmp_path):
    return [left_behind(tmp_path / f"rig_{i}", k) for i, k in enumerate(STIFFNESS)]


def test_the_command_and_python_find_the_same(runs, pinn_run):
    left_behind(Path(runs[2]), 16.0, std=60.0, verdict="questionable")
    names = [Path(run).name for run in runs]
    outcome = pinn_run("population", *names, "hydra.run.dir=found").done()
    assert {file.name for file in Path("found").iterdir()} >= {"population.csv", "population_mean.csv", "figures"}
    assert (Path("found") / "figures" / "population.png").is_file()
    report = population(*names, directory="again")
    assert Path("again/population.csv").is_file()
    written = pd.read_csv("found/population.csv")
    np.testing.assert_allclose(written["estimate"], report.structures["estimate"], rtol=1e-8)
    assert written["structure"].unique().tolist() == names
    assert outcome.out.splitlines()[2:9] == report.text().splitlines()[2:9]
    assert "questionable by themselves: rig_2" in outcome.out
    assert "rig_2 borrows from the others: k_1" in outcome.out
    of_k = report.mean.set_index("parameter").loc["k_1"]
    assert of_k["mean_lower_90"] < 15.0 < of_k["mean_upper_90"]
    poor = report.structures.query("structure.str.endswith('rig_2') and parameter == 'k_1'").iloc[0]
    assert poor["std"] < 2.0 < 10.0 < poor["alone_std"]


def test_an_outlier_and_the_parameters_in_common_are_told(runs, tmp_path, pinn_run):
    wrong = left_behind(tmp_path / "damaged", 40.0, kinds=("k",))
    more = [left_behind(tmp_path / f"more_{i}", k) for i, k in enumerate(STIFFNESS + 0.1)]
    outcome = pinn_run("--json", "population", *runs, *more, wrong, "figures=false").done()
    told = json.loads(outcome.out)
    assert [row["parameter"] for row in told["population_mean"]] == ["k_1", "k_2"]
    outliers = [row for row in told["population"] if row["outlier"]]
    assert [(row["structure"], row["parameter"]) for row in outliers] == [(wrong, "k_1")]
    assert outliers[0]["off"] > 5.0


def test_of_a_sweep_those_that_failed_are_left_out(tmp_path, pinn_run):
    paths = [f"data.path=rigs/rig_{i}.csv" for i in range(7)]
    tables = dict.fromkeys(paths[:6], "case\n") | {paths[6]: None}
    sweep = made_sweep(tmp_path / "sweep", ["data.path=" + ",".join(p.partition("=")[2] for p in paths)], tables)
    jobs = sweep.jobs()
    for job, k in zip(jobs[:6], STIFFNESS, strict=True):
        left_behind(job.directory, k, verdict="failed" if k == 16.0 else "sound")
    out = pinn_run("population", "sweep").done().out
    assert "left out: rig_2.csv: its verdict is failed: why" in out
    assert "left out: rig_6.csv: " in out
    assert out.startswith("5 structures")
    named = pinn_run("population", *(str(job.directory.relative_to(tmp_path)) for job in jobs[3:6])).done()
    assert named.out.startswith("3 structures")  # though their names have equals signs


def test_what_is_no_population_is_refused(runs, tmp_path, pinn_run):
    pinn_run("population").refused("population=nothing: must be 3 finished runs or more")
    pinn_run("population", *runs[:2]).refused("there are 2 that can be used")
    pinn_run("population", *runs, "nowhere").refused("nowhere", "there is no such directory")
    pinn_run("population", *runs, "system=linear", "data=csv").refused("data=csv: must be left out with population")
    other = left_behind(tmp_path / "other", 15.0, kinds=("c",))
    pinn_run("population", *runs, other).refused("runs with uncertain parameters in common", "k_1, k_2, m_1, m_2")
    (Path(runs[0]) / "model.npz").unlink()
    pinn_run("population", *runs).refused("it has no model.npz")
    left_behind(Path(runs[0]), 15.0, std=np.nan)
    with pytest.raises(InputError, match="tells no standard deviations"):
        population(*runs)
    assert not Path("outputs").exists()
