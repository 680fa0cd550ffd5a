"""Noise seeds and nonlinearity: realisations, tables and figure."""

import pandas as pd
import pytest

from pinn_cli.paper.realisations import ScoredRealisations
from pinn_cli.paper.studies import SeedScores, nonlinearity_realisations, seed_realisations, spread_text


def test_every_realisation_is_one_of_its_own():
    for realisations in (seed_realisations(), nonlinearity_realisations()):
        assert len(realisations) == len({one.name for one in realisations}) == 120
        assert len({one.overrides for one in realisations}) == 120


@pytest.mark.usefixtures("quick")
def test_seeds_are_summarised_as_mean_and_spread(tmp_path, solver):
    seeds = SeedScores.of(ScoredRealisations.made(seed_realisations(), tmp_path / "runs", solver))
    cells = seeds.summary[(seeds.summary["case"] == "sr_6dof_snr50") & (seeds.summary["group"] == "all")]
    ours = cells[(cells["estimator"] == "pinn") & (cells["quantity"] == "displacement")].iloc[0]
    assert ours["seeds"] == 3
    assert ours["range_fitness_mean"] == pytest.approx(ours["published"] + 0.2 - 0.1)
    assert ours["error_percent_mean"] == pytest.approx(ours["range_error_percent_mean"] + 5.0)
    assert ours["error_percent_std"] == pytest.approx(0.1 * pd.Series(range(3)).std())
    parameters = seeds.parameter_summary.set_index(["case", "estimator", "parameter"])
    assert parameters.loc[("sp_5dof_snr50", "pinn", "k_2"), "error_percent_mean"] == pytest.approx(1.0)
    assert parameters.loc[("sp_5dof_snr50", "pinn", "k_2"), "inside_90_percent"] == 100.0
    assert parameters.loc[("sp_5dof_snr50", "kalman_smoother", "k_2"), "inside_90_percent"] == 0.0
    sheets = seeds.sheets
    assert [sheet.name for sheet in sheets] == ["seeds_table2", "seeds_table5", "seeds_parameters"]
    text = sheets[0].markdown
    assert "| 6 DOFs, Duffing, no error, 50 dB | published | 1.43 |" in text
    assert "|  | ours | 1.33 ± 0.10 ▲ |" in text
    assert "over 3 draws" in text
    assert all(sheet.latex.isascii() for sheet in sheets)
    seeds.write(tmp_path)
    names = {file.name for file in tmp_path.glob("*.csv")}
    assert names == {"seeds.csv", "seeds_parameters.csv", "summary.csv", "summary_parameters.csv"}
    written = pd.read_csv(tmp_path / "seeds.csv")
    assert not written.duplicated(["case", "seed", "estimator", "group", "quantity"]).any()


@pytest.mark.usefixtures("quick")
def test_a_part_of_the_seeds_is_a_table_too(tmp_path, solver):
    solver.interrupted_after = 5
    with pytest.raises(KeyboardInterrupt):
        SeedScores.of(ScoredRealisations.made(seed_realisations(), tmp_path / "runs", solver))
    seeds = SeedScores.of(ScoredRealisations.read(seed_realisations(), tmp_path / "runs"))
    assert "over 2 to 3 (of 3) draws" in seeds.sheets[0].markdown
    assert len(seeds.scored.missing) == 31


@pytest.mark.parametrize(
    ("mean", "std", "text"),
    [(0.0123, 0.0041, "0.012 ± 0.004"), (1.234, 0.5, "1.23 ± 0.50"), (44.12, 25.0, "44.1 ± 25.0"),
     (0.5, float("nan"), "0.50"), (float("nan"), 1.0, "-")],
)  # fmt: skip
def test_decimals_of_a_mean(mean, std, text):
    assert spread_text(mean, std) == text


def test_the_nonlinearity_is_averaged_and_drawn(paper):
    place = paper / "nonlinearity"
    table = pd.read_csv(place / "nonlinearity.csv")
    assert set(table["quantity"]) == {"displacement", "velocity", "acceleration"}
    assert table["fitness_percent"].between(91.0, 93.0).all()
    assert len(table) == (3 * 2 * 2 - 1) * 2 * 3  # one has diverged
    assert (place / "nonlinearity.png").read_bytes().startswith(b"\x89PNG")
    assert (place / "nonlinearity.pdf").read_bytes().startswith(b"%PDF")
    assert "none_kappa10000_force10_seed0: loss is not finite" in (paper / "report.html").read_text()
