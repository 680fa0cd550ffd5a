"""The two studies: their jobs, tables, figure, and what the report shows of them."""

from __future__ import annotations

import pandas as pd
import pytest

from pinn_cli.paper.sheet_files import html, latex, markdown
from pinn_cli.paper.study.noise_seeds import make_seed_study, read_seed_study, seed_jobs
from pinn_cli.paper.study.nonlinearity import make_nonlinearity_study, nonlinearity_jobs, read_nonlinearity_study
from pinn_cli.paper.study.seeds_sheet import seed_sheets, spread_text
from pinn_cli.paper.study_sections import nonlinearity_section, seeds_section


def test_twelve_cases_by_ten_seeds():
    jobs = seed_jobs()
    assert len(jobs) == len({job.name for job in jobs}) == 120
    assert jobs[0].command == (
        "experiment=paper/sr_6dof_snr50", "baseline=kalman_smoother", "noise.seeds=null", "seed=0"
    )  # fmt: skip


def test_the_grid_holds_the_defaults_and_what_is_asked_for():
    jobs = nonlinearity_jobs()
    assert len(jobs) == len({job.name for job in jobs})
    kappas, forces = ({dict(job.columns)[name] for job in jobs} for name in ("kappa", "force_rms"))
    assert {0.0, 100.0, 10000.0} <= kappas
    assert forces == {0.3, 1.0, 3.0, 10.0}
    assert {override for job in jobs for override in job.overrides if override.startswith("model_error")} == {
        "model_error=none", "model_error=linear", "model_error=perturbed"
    }  # fmt: skip


def test_seeds_are_summarised_as_mean_and_spread(tmp_path, solver):
    study = make_seed_study(tmp_path, solver)
    cells = study.summary[(study.summary["case"] == "sr_6dof_snr50") & (study.summary["group"] == "all")]
    ours = cells[(cells["estimator"] == "pinn") & (cells["quantity"] == "displacement")].iloc[0]
    assert ours["seeds"] == 10
    assert ours["range_fitness_mean"] == pytest.approx(ours["published"] + 0.2 - 0.45)
    assert ours["error_percent_mean"] == pytest.approx(ours["range_error_percent_mean"] + 5.0)
    assert ours["error_percent_std"] == pytest.approx(0.1 * pd.Series(range(10)).std())
    parameters = study.parameter_summary.set_index(["case", "estimator", "parameter"])
    assert parameters.loc[("sp_5dof_snr50", "pinn", "k_2"), "error_percent_mean"] == pytest.approx(1.0)
    assert parameters.loc[("sp_5dof_snr50", "pinn", "k_2"), "inside_90_percent"] == 100.0
    assert parameters.loc[("sp_5dof_snr50", "kalman_smoother", "k_2"), "inside_90_percent"] == 0.0
    names = {file.name for file in tmp_path.glob("*.csv")}
    assert names == {"seeds.csv", "seeds_parameters.csv", "summary.csv", "summary_parameters.csv"}
    written = pd.read_csv(tmp_path / "seeds.csv")
    assert not written.duplicated(["case", "seed", "estimator", "group", "quantity"]).any()


def test_tables_of_the_seeds(tmp_path, solver):
    sheets = seed_sheets(make_seed_study(tmp_path, solver))
    assert [sheet.name for sheet in sheets] == ["seeds_table2", "seeds_table5", "seeds_parameters"]
    text = markdown(sheets[0])
    assert "| 6 DOFs, Duffing, no error, 50 dB | published | 1.43 |" in text
    assert "|  | ours | 1.68 ± 0.30 ▼ |" in text
    assert "over 10 draws" in text
    assert all(latex(sheet).isascii() and "<table>" in html(sheet) for sheet in sheets)


def test_a_part_of_the_seeds_is_a_table_too(tmp_path, solver):
    solver.interrupted_after = 15
    with pytest.raises(KeyboardInterrupt):
        make_seed_study(tmp_path, solver)
    study = read_seed_study(tmp_path)
    assert "over 5 to 10 (of 10) draws" in markdown(seed_sheets(study)[0])
    assert "105 more are missing" in seeds_section(study)


@pytest.mark.parametrize(
    ("mean", "std", "text"),
    [(0.0123, 0.0041, "0.012 ± 0.004"), (1.234, 0.5, "1.23 ± 0.50"), (44.12, 25.0, "44.1 ± 25.0"),
     (0.5, float("nan"), "0.50"), (float("nan"), 1.0, "-")],
)  # fmt: skip
def test_decimals_of_a_mean(mean, std, text):
    assert spread_text(mean, std) == text


def test_the_nonlinearity_is_averaged_and_drawn(tmp_path, solver):
    jobs = nonlinearity_jobs()
    solver.diverging = {job.name for job in jobs if "none_kappa10000_force10_" in job.name}
    study = make_nonlinearity_study(tmp_path, solver)
    table = pd.read_csv(tmp_path / "nonlinearity.csv")
    assert set(table["quantity"]) == {"displacement", "velocity", "acceleration"}
    assert table["fitness_percent"].between(91.0, 93.0).all()
    assert len(table) == (len(jobs) // 2 - 1) * 2 * 3
    assert (tmp_path / "nonlinearity.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "nonlinearity.pdf").read_bytes().startswith(b"%PDF")
    section = nonlinearity_section(study, tmp_path / "nonlinearity.png")
    assert "force and noise of 2 seeds" in section
    assert "loss is not finite" in section


def test_what_is_not_there_is_said_with_its_command(tmp_path):
    assert "make seeds" in seeds_section(read_seed_study(tmp_path))
    assert "make nonlinearity" in nonlinearity_section(read_nonlinearity_study(tmp_path), None)
