"""Whole runs of Bayesian estimation, small: what they leave behind, what they take over, and what is refused."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calls import SMALL, Outcome, PinnRun

BAYESIAN = (*SMALL, "system.ndof=2", "scheme=bayesian", "noise.snr_db=25", "noise.repeats=2")
SAMPLED = (*BAYESIAN, "posterior.chains=2", "posterior.warmup=50", "posterior.draws=100")
NAMES = [f"{kind}_{dof}" for kind in ("c", "k", "kappa") for dof in (1, 2)]
FIGURES = {"posterior_pairs", "trace", "ranks", "fitted_force"}
CHAINS = ["chain_1.npz", "chain_2.npz"]


def draws(outcome: Outcome) -> dict[str, np.ndarray]:
    with xr.open_dataset(outcome.directory / "posterior.nc", group="posterior") as posterior:
        return {str(name): values.values.copy() for name, values in posterior.items()}


def test_a_run_leaves_its_posterior(pinn_run: PinnRun) -> None:
    outcome = pinn_run(*SAMPLED, "figures=false").done()
    left = {entry.name for entry in outcome.directory.iterdir()}
    assert {"posterior.nc", "diagnostics.csv", "parameters.csv", "fitness.csv", "response.nc", "run.json"} <= left
    assert sorted(entry.name for entry in (outcome.directory / "chains").iterdir()) == CHAINS
    check_parameters(outcome)
    check_run_record(outcome)
    check_groups(outcome)


@pytest.mark.slow
def test_a_second_start_takes_over_what_was_finished_and_the_seed_decides_the_rest(pinn_run, tmp_path):
    first = pinn_run(*SAMPLED, "hydra.run.dir=first", "seed=3")
    found, found_draws, chains = first.parameters, draws(first), tmp_path / "first" / "chains"
    assert {figure.stem for figure in (first.directory / "figures").iterdir()} >= FIGURES
    before = {name: (chains / name).stat().st_mtime_ns for name in CHAINS}
    again = pinn_run(*SAMPLED, "figures=false", "hydra.run.dir=first", "seed=3").done()
    assert {name: (chains / name).stat().st_mtime_ns for name in CHAINS} == before
    assert "2 of 2 chains were finished before" in (again.directory / "pinn-run.log").read_text()
    elsewhere = pinn_run(*SAMPLED, "figures=false", "hydra.run.dir=second", "seed=3")
    assert "finished before" not in (elsewhere.directory / "pinn-run.log").read_text()
    for outcome in (again, elsewhere):
        pd.testing.assert_frame_equal(outcome.parameters, found)
        for name, values in draws(outcome).items():
            np.testing.assert_array_equal(found_draws[name], values)


def check_parameters(outcome: Outcome) -> None:
    table = outcome.parameters
    assert list(table.index) == NAMES
    assert set(table["scheme"]) == {"bayesian"}
    posterior = draws(outcome)
    for name in NAMES:
        values = posterior[name]
        assert values.shape == (2, 100)
        assert (values > 0).all()
        row = table.loc[name]
        assert row["estimate"] == pytest.approx(values.mean(), rel=1e-6)
        assert row["std"] == pytest.approx(values.std(), rel=0.02)
        quantiles = np.quantile(values, (0.05, 0.95))
        np.testing.assert_allclose(row[["lower_90", "upper_90"]].astype(float), quantiles, rtol=1e-6)
        assert abs(row["estimate"] - row["true"]) < 5.0 * row["std"]


def check_run_record(outcome: Outcome) -> None:
    record = outcome.record
    told = record["posterior"]
    assert (told["method"], told["chains"], told["warmup"], told["draws"]) == ("marginal", 2, 50, 100)
    assert len(told["seconds_by_chain"]) == 2
    assert told["smallest_ess_bulk"] < 400.0
    assert any("effective" in text or "ESS" in text for text in told["quality_check"])  # 200 draws are too few
    assert record["verdict"] != "sound"
    assert any("quality check" in text for text in record["reasons"])
    assert record["seconds"]["posterior"] >= 0.9 * sum(told["seconds_by_chain"])
    printed = " ".join(outcome.out.split())
    assert all(text in printed for text in told["quality_check"])


def check_groups(outcome: Outcome) -> None:
    file = outcome.directory / "posterior.nc"
    diagnostics = pd.read_csv(outcome.directory / "diagnostics.csv")
    assert set(NAMES) <= set(diagnostics["parameter"])
    for group in ("posterior", "prior", "posterior_predictive", "observed_data", "sample_stats"):
        with xr.open_dataset(file, group=group) as data:
            assert data.sizes
    with xr.open_dataset(file, group="sample_stats") as statistics:
        assert statistics["diverging"].shape == (2, 100)


@pytest.mark.parametrize("choice", ["laplace", pytest.param("conditional", marks=pytest.mark.slow)])
def test_the_other_posteriors(pinn_run: PinnRun, choice: str) -> None:
    few = ("posterior.draws=200",) if choice == "laplace" else SAMPLED[-3:]
    outcome = pinn_run(*BAYESIAN, f"posterior={choice}", *few, "figures=false").done()
    assert list(outcome.parameters.index) == NAMES
    record = outcome.record
    assert record["posterior"]["method"] == choice


SETTINGS = {
    "training=adam network=mlp": "training=adam: must be gauss_newton",
    "posterior=marginals": "posterior=marginals",
    "scheme.unobserved=[2]": "scheme=bayesian: must be a sensor on every DOF",
    "noise.repeat_streams=shared": "noise.repeat_streams=shared",
    "noise.snr_db=null": "noise.repeats=2",
    "training.weights={observation: 1, continuity: 1, physics: 1}": "training.weights=",
}


@pytest.mark.parametrize(("overrides", "told"), SETTINGS.items(), ids=SETTINGS.keys())
def test_what_cannot_be_is_refused_and_nothing_is_left_behind(pinn_run, tmp_path, overrides, told):
    given = overrides.split() if overrides.startswith("training=") else [overrides]
    pinn_run(*BAYESIAN, *given).refused(f"pinn-run: {told}")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_measured_record(pinn_run: PinnRun, tmp_path: Path) -> None:
    simulated = pinn_run(*BAYESIAN, "posterior=laplace")
    with xr.open_dataset(simulated.directory / "response.nc") as response:
        columns = {"t": response["time"].values, "f": response["force_observed"].sel(dof=1).values}
        for dof in (1, 2):
            columns[f"u{dof}"] = response["displacement_observed"].sel(dof=dof).values
    pd.DataFrame(columns).to_csv(tmp_path / "rig.csv", index=False)
    settings = ["data.path=rig.csv", "data.time=t", "data.force={1: f}", "data.displacement={1: u1, 2: u2}"]
    own = [text for text in BAYESIAN if not text.startswith(("simulation.", "excitation.", "noise."))]
    outcome = pinn_run(*own, "data=csv", *settings, "posterior=laplace", "system.m=10").done()
    table = outcome.parameters
    assert list(table.index) == NAMES
    assert table["true"].isna().all()
    assert abs(table.loc["k_2", "estimate"] - 15.0) < 4.0 * table.loc["k_2", "std"]


HYSTERETIC = (
    "system=structure", "system.dofs=[a,b]", "system.mass={a:2000,b:1500}", "excitation.band=[0.5,12]",
    "excitation.rms=3000", "excitation.dofs=[b]", "simulation.duration=10", "simulation.samples=1001",
    "noise.snr_db=30", "scheme=bayesian", "scheme.initial_motion=rest", "posterior=laplace", "figures=false",
    ("system.connections={s1:{between:[ground,a],law:bouc_wen,c:4500,k:1.5e6,A:4e5,beta:120,gamma:80,n:1},"
    "s2:{between:[a,b],law:linear,c:4200,k:1.4e6}}"),
)  # fmt: skip


@pytest.mark.slow
def test_a_structure_with_memory(pinn_run: PinnRun) -> None:
    """Under Gaussians hundreds of times as wide as the parameters it ended where the brace has no stiffness."""
    outcome = pinn_run(*HYSTERETIC).done()
    table = outcome.parameters
    assert (table.loc[["k_s1", "k_s2", "A_s1"], "error_percent"] < 8.0).all()
    apart = (table["estimate"] - table["true"]) / table["std"]
    assert (apart.abs() < 3.5).all()
