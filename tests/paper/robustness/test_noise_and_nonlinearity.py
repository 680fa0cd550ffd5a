"""Noise seeds and nonlinearity: realisations, tables and figure."""

from __future__ import annotations

import pandas as pd
import pytest

from pinn_cli.paper.rendering import latex, markdown
from pinn_cli.paper.robustness.noise_seeds import SeedScores, seed_realisations
from pinn_cli.paper.robustness.nonlinearity import NonlinearityScores, nonlinearity_realisations
from pinn_cli.paper.robustness.nonlinearity_figure import write_nonlinearity_figure
from pinn_cli.paper.robustness.scored import read_scores, solve_missing
from pinn_cli.paper.robustness.seed_sheets import seed_sheets, spread_text


def test_twelve_cases_by_ten_seeds():
    realisations = seed_realisations()
    assert len(realisations) == len({one.name for one in realisations}) == 120
    assert realisations[0].overrides == (
        "experiment=paper/sr_6dof_snr50", "baseline=kalman_smoother", "noise.seeds=null", "seed=0"
    )  # fmt: skip


def test_the_grid_holds_the_defaults_and_what_is_asked_for():
    realisations = nonlinearity_realisations()
    assert len(realisations) == len({one.name for one in realisations})
    kappas, forces = ({dict(one.columns)[name] for one in realisations} for name in ("kappa", "force_rms"))
    assert {0.0, 100.0, 10000.0} <= kappas
    assert forces == {0.3, 1.0, 3.0, 10.0}
    assert {override for one in realisations for override in one.settings if override.startswith("model_error")} == {
        "model_error=none", "model_error=linear", "model_error=perturbed"
    }  # fmt: skip


def test_seeds_are_summarised_as_mean_and_spread(tmp_path, solver):
    seeds = SeedScores.of(solve_missing(seed_realisations(), tmp_path / "runs", solver))
    cells = seeds.summary[(seeds.summary["case"] == "sr_6dof_snr50") & (seeds.summary["group"] == "all")]
    ours = cells[(cells["estimator"] == "pinn") & (cells["quantity"] == "displacement")].iloc[0]
    assert ours["seeds"] == 10
    assert ours["range_fitness_mean"] == pytest.approx(ours["published"] + 0.2 - 0.45)
    assert ours["error_percent_mean"] == pytest.approx(ours["range_error_percent_mean"] + 5.0)
    assert ours["error_percent_std"] == pytest.approx(0.1 * pd.Series(range(10)).std())
    parameters = seeds.parameter_summary.set_index(["case", "estimator", "parameter"])
    assert parameters.loc[("sp_5dof_snr50", "pinn", "k_2"), "error_percent_mean"] == pytest.approx(1.0)
    assert parameters.loc[("sp_5dof_snr50", "pinn", "k_2"), "inside_90_percent"] == 100.0
    assert parameters.loc[("sp_5dof_snr50", "kalman_smoother", "k_2"), "inside_90_percent"] == 0.0
    seeds.write(tmp_path)
    names = {file.name for file in tmp_path.glob("*.csv")}
    assert names == {"seeds.csv", "seeds_parameters.csv", "summary.csv", "summary_parameters.csv"}
    written = pd.read_csv(tmp_path / "seeds.csv")
    assert not written.duplicated(["case", "seed", "estimator", "group", "quantity"]).any()


def test_tables_of_the_seeds(tmp_path, solver):
    sheets = seed_sheets(SeedScores.of(solve_missing(seed_realisations(), tmp_path / "runs", solver)))
    assert [sheet.name for sheet in sheets] == ["seeds_table2", "seeds_table5", "seeds_parameters"]
    text = markdown(sheets[0])
    assert "| 6 DOFs, Duffing, no error, 50 dB | published | 1.43 |" in text
    assert "|  | ours | 1.68 ± 0.30 ▼ |" in text
    assert "over 10 draws" in text
    assert all(latex(sheet).isascii() for sheet in sheets)


def test_a_part_of_the_seeds_is_a_table_too(tmp_path, solver):
    solver.interrupted_after = 15
    with pytest.raises(KeyboardInterrupt):
        SeedScores.of(solve_missing(seed_realisations(), tmp_path / "runs", solver))
    seeds = SeedScores.of(read_scores(seed_realisations(), tmp_path / "runs"))
    assert "over 5 to 10 (of 10) draws" in markdown(seed_sheets(seeds)[0])
    assert len(seeds.scored.missing) == 105


@pytest.mark.parametrize(
    ("mean", "std", "text"),
    [(0.0123, 0.0041, "0.012 ± 0.004"), (1.234, 0.5, "1.23 ± 0.50"), (44.12, 25.0, "44.1 ± 25.0"),
     (0.5, float("nan"), "0.50"), (float("nan"), 1.0, "-")],
)  # fmt: skip
def test_decimals_of_a_mean(mean, std, text):
    assert spread_text(mean, std) == text


def test_the_nonlinearity_is_averaged_and_drawn(tmp_path, solver):
    realisations = nonlinearity_realisations()
    solver.diverging = {one.name for one in realisations if "none_kappa10000_force10_" in one.name}
    scores = NonlinearityScores.of(solve_missing(realisations, tmp_path / "runs", solver))
    write_nonlinearity_figure(scores, tmp_path)
    scores.write(tmp_path)
    table = pd.read_csv(tmp_path / "nonlinearity.csv")
    assert set(table["quantity"]) == {"displacement", "velocity", "acceleration"}
    assert table["fitness_percent"].between(91.0, 93.0).all()
    assert len(table) == (len(realisations) // 2 - 1) * 2 * 3
    assert (tmp_path / "nonlinearity.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "nonlinearity.pdf").read_bytes().startswith(b"%PDF")
    assert scores.scored.failures[0].endswith("loss is not finite")
