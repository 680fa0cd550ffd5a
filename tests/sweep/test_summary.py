"""What a sweep says: means and spreads over seeds, models of one record compared by their evidence, and the figures."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from sweeps import made_sweep

from pinn_cli import InputError, Structure, run
from pinn_cli.sweep.collect import collected
from pinn_cli.sweep.jobs import Sweep
from pinn_cli.sweep.summary import (
    compared,
    is_seed,
    models_figure,
    models_text,
    numeric_settings,
    summarise,
    sweep_figure,
)


def fitness(**settings: list[object]) -> pd.DataFrame:
    """A row per combination of settings and quantity; its fitness grows with the seed, and one job has failed."""
    rows = pd.DataFrame({"estimator": ["pinn"], "group": ["all"], "status": ["finished"]})
    for name, values in {**settings, "quantity": ["displacement", "force"]}.items():
        rows = rows.merge(pd.DataFrame({name.replace("__", "."): values}), how="cross")
    rows["fitness_percent"] = 90.0 + rows["seed"].astype(float)
    rows["range_fitness_percent"] = 99.0
    failed = {name.replace("__", "."): values[0] for name, values in settings.items()} | {"status": "failed"}
    return pd.concat([rows, pd.DataFrame([failed])], ignore_index=True)


def test_mean_spread_and_number_of_seeds() -> None:
    table = summarise(fitness(noise__snr_db=["50", "20"], seed=["0", "1", "5"]), ["noise.snr_db", "seed"])
    assert list(table.columns[:4]) == ["noise.snr_db", "estimator", "group", "quantity"]
    assert len(table) == 4
    np.testing.assert_allclose(table["fitness_percent_mean"], 92.0)
    np.testing.assert_allclose(table["fitness_percent_std"], np.sqrt(7.0))
    np.testing.assert_allclose(table["range_fitness_percent_std"], 0.0)
    assert table["seeds"].tolist() == [3] * 4
    assert table.groupby("noise.snr_db", sort=False)["failed"].first().to_dict() == {"50": 1, "20": 0}


def test_one_seed_no_truth_and_nothing_but_seeds_or_failures() -> None:
    rows = fitness(a=["x"], seed=["0"])
    rows.loc[rows["quantity"] == "force", "fitness_percent"] = np.nan
    table = summarise(rows, ["a", "seed"])
    assert table["quantity"].tolist() == ["displacement"]
    assert table["fitness_percent_std"].isna().all()
    table = summarise(fitness(seed=["0", "1"]), ["seed"])
    assert table["seeds"].tolist() == [2, 2]
    assert table["failed"].tolist() == [1, 1]
    table = summarise(fitness(a=["x", "y"], seed=["0"]).assign(status="failed"), ["a", "seed"])
    assert set(table["a"]) <= {"x", "y"}


@pytest.mark.parametrize("name", ["seed", "excitation.seed", "noise.seeds", "model_error.force_seed"])
def test_seeds(name: str) -> None:
    assert is_seed(name)
    assert not is_seed(name + "ing")


def test_a_figure_has_a_column_per_numeric_setting_and_lines_for_the_others() -> None:
    settings = {"a": ["1", "10", "100"], "b": ["2.5", "3"], "scheme": ["x", "y"]}
    table = summarise(fitness(**settings, seed=["0", "1"]), [*settings, "seed"])
    assert numeric_settings(table, [*settings]) == ["a", "b"]
    figure = sweep_figure(table, [*settings])
    axes = figure.axes
    assert [axis.get_xlabel() for axis in axes if axis.get_xlabel()] == ["a", "b"]
    assert axes[0].get_xscale() == "log"
    assert axes[1].get_xscale() == "linear"
    assert len(axes[0].containers) == 4  # b times scheme
    assert len(axes[1].containers) == 6
    np.testing.assert_allclose(axes[0].containers[0].lines[0].get_ydata(), 9.5)
    low, high = axes[0].get_ylim()
    assert [tick for tick in axes[0].get_yticks() if low <= tick <= high]


def test_many_lines_are_told_by_their_median_and_no_number_has_no_figure() -> None:
    table = summarise(fitness(a=["1", "2"], b=[str(n) for n in range(12)], seed=["0"]), ["a", "b", "seed"])
    figure = sweep_figure(table, ["a", "b"])
    assert figure.axes[0].get_legend_handles_labels()[1] == ["median of 12 other settings"]
    table = summarise(fitness(scheme=["x", "y"], seed=["0"]), ["scheme", "seed"])
    assert sweep_figure(table, ["scheme"]) is None


FITNESS = "estimator,group,quantity,fitness_percent,range_fitness_percent\npinn,all,force,,\n"


def sweep_of(directory: Path, swept: str, models: Mapping[str, Mapping[str, Any]]) -> Sweep:
    """A finished sweep; by the override that tells a job: its evidence, and what it saw."""
    sweep = made_sweep(directory, [swept, "scheme=state_parameter"], dict.fromkeys(models, FITNESS))
    for job in sweep.jobs():
        own = models[job.overrides[0]]
        record = {"training": {"model_log_evidence": own.get("evidence")}, "observed": own.get("observed", "a")}
        (job.directory / "run.json").write_text(json.dumps(record | {"verdict": "sound"}))
        table = pd.DataFrame({"std": own.get("std", [0.1]), "prior_std": 1.0})
        table.to_csv(job.directory / "identifiability.csv", index=False)
        parameters = {"estimator": "pinn", "start": [1.0] * len(table)}
        pd.DataFrame(parameters).to_csv(job.directory / "parameters.csv", index=False)
        if "nmse" in own:
            pd.DataFrame({"nmse_percent": own["nmse"]}).to_csv(job.directory / "validation.csv", index=False)
    return sweep


def test_probabilities_follow_from_evidence(tmp_path: Path) -> None:
    models = {
        "system=linear": {"evidence": -1000.0, "std": [0.1, 2.0], "nmse": [4.0, 2.0]},
        "system=duffing": {"evidence": -1000.0 + np.log(3.0), "nmse": [0.1, 0.3]},
        "system=van_der_pol": {"evidence": -5000.0},
    }
    sweep = sweep_of(tmp_path, "system=linear,duffing,van_der_pol", models)
    found = compared(sweep, sweep.jobs())
    table = found.table.set_index("system")
    assert table.index.tolist() == ["duffing", "linear", "van_der_pol"]
    np.testing.assert_allclose(table["probability"], [0.75, 0.25, 0.0], atol=1e-12)
    np.testing.assert_allclose(table["log_bayes_factor"], [0.0, -np.log(3.0), -4000.0 - np.log(3.0)])
    np.testing.assert_allclose(table["validation_nmse_percent"], [0.2, 3.0, np.nan])
    np.testing.assert_allclose(table["effective_parameters"], [0.99, 0.99, 0.99])
    assert table["unknown"].tolist() == [1, 2, 1]
    assert "0.750" in models_text(found)
    assert isinstance(models_figure(found.table, found.settings), Figure)


def test_what_else_is_swept_keeps_models_apart(tmp_path: Path) -> None:
    sweep = made_sweep(tmp_path / "sweep", ["system=linear,duffing", "data.start=1,2"], {})
    for job in sweep.jobs():
        (job.directory / ".hydra").mkdir(parents=True)
        (job.directory / ".hydra" / "overrides.yaml").write_text(json.dumps(list(job.overrides)))
        start = float(job.overrides[1][-1])
        evidence = -10.0 * start - ("system=linear" in job.overrides)
        record = {"training": {"model_log_evidence": evidence}, "observed": str(start)}
        (job.directory / "run.json").write_text(json.dumps(record))
    found = compared(sweep, sweep.jobs())
    for _, group in found.table.groupby("data.start"):
        np.testing.assert_allclose(group["probability"], [1.0 / (1.0 + np.exp(-1.0)), 1.0 / (1.0 + np.exp(1.0))])


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        ({"evidence": 1.0, "observed": "b"}, "system=linear and system=duffing saw different records or sensors"),
        ({"evidence": None}, "system=duffing has no evidence"),
    ],
)
def test_what_cannot_be_compared_is_told_in_one_line(tmp_path: Path, other: dict[str, Any], reason: str) -> None:
    sweep = sweep_of(
        tmp_path, "system=linear,duffing", {"system=linear": {"evidence": 1.0}, "system=duffing": other}
    )  # fmt: skip
    (tmp_path / "models.csv").write_text("of an earlier look")
    _, text = collected(sweep, sweep.jobs())
    assert f"models are not compared: {reason}" in text
    assert not (tmp_path / "models.csv").exists()


def test_a_sweep_over_no_models_says_nothing(tmp_path: Path) -> None:
    sweep = made_sweep(tmp_path, ["seed=0,1"], {"seed=0": FITNESS, "seed=1": FITNESS})
    assert compared(sweep, sweep.jobs()) is None


@pytest.fixture(scope="module")
def record() -> Any:
    """A hardening spring at 40 dB."""
    chain = Structure.chain("duffing", m=40.0, c=30.0, k=6e3, kappa=2e7)
    time = 0.025 * np.arange(300)
    force = sum(np.sin(2.0 * np.pi * f * time + 3.0 * f) for f in (1.1, 1.7, 2.3, 3.3))
    return chain.simulate(time, {1: 60.0 * np.asarray(force)}).keep({"acceleration": [1]}).with_noise(40.0, 1)


RIG = ("scheme=state_parameter", "scheme.unknown=missing", "system.ndof=1", "system.m=40", "figures=false", "threads=1")


@pytest.mark.slow
def test_the_true_law_wins(record: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    sweep = run("system=linear,duffing", "data.validation={start: 6, stop: 7.475}", *RIG, data=record, multirun=True)
    models = sweep.table("models").set_index("system")
    assert models.index[0] == "duffing"
    assert models["log_bayes_factor"]["linear"] < -100.0
    assert models["validation_nmse_percent"]["duffing"] < 1.0 < models["validation_nmse_percent"]["linear"]
    assert (sweep.directory / "figures" / "models.png").is_file()


@pytest.mark.slow
def test_the_evidence_is_that_of_the_model_and_its_prior_not_of_the_features(record: Any) -> None:
    def trained(*overrides: str) -> dict[str, Any]:
        return run(*overrides, *RIG, data=record, keep=False).run_record["training"]

    coarse, fine = (trained("system=duffing", f"network.knots_per_period={knots}") for knots in (6, 10))
    assert abs(coarse["log_evidence"] - fine["log_evidence"]) > 100.0  # what it is not
    assert fine["model_log_evidence"] == pytest.approx(coarse["model_log_evidence"], abs=6.0)
    narrow, wide = (trained("system=linear", f"scheme.prior_width={width}") for width in (10.0, 100.0))
    costs = narrow["model_log_evidence"] - wide["model_log_evidence"]
    assert costs == pytest.approx(2.0 * np.log(10.0), abs=0.5)  # of c and k


@pytest.mark.slow
def test_missing_values_are_named_together(record: Any) -> None:
    given = ("system=linear", "system.c=30", "system.k=6e3")
    with pytest.raises(InputError, match="scheme.unknown=missing: must be used with a structure that lacks values"):
        run(*given, *RIG, data=record)
    found = run("system=linear", "system.c=30", *RIG, data=record, keep=False)
    assert found.parameters.set_index("parameter")["start"].notna().to_dict() == {"c_1": False, "k_1": True}
