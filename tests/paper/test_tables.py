"""Published values beside ours, with stand-ins for the runs; noise seeds and nonlinearity."""

import math
import re

import pandas as pd
import pytest

from pinn_cli.cli.composing import compose_config
from pinn_cli.cli.config import RunConfig
from pinn_cli.paper.__main__ import make_table
from pinn_cli.paper.realisations import ScoredRealisations
from pinn_cli.paper.runs import TABLES, CaseFailedError
from pinn_cli.paper.studies import SeedScores, seed_realisations, spread_text
from pinn_cli.paper.tables import (
    FITNESS_COLUMNS,
    PAPER_PARAMETER_COLUMNS,
    RUN,
    compare_fitness,
    compare_parameters,
    compare_wrong_values,
    fitness_sheet,
    parameter_sheet,
    wrong_values_sheet,
)
from pinn_cli.report.sheet import Cell, written

TABLE1, TABLE2, TABLE3, *_ = TABLES
NAN = float("nan")


def _found(case: str, variant: str, rows: pd.DataFrame) -> pd.DataFrame:
    return rows.assign(case=case, variant=variant, seconds=3.0, process_seconds=5.0)


def _fitness(case: str, variant: str, offset: float) -> pd.DataFrame:
    cells = TABLE2.values.loc[lambda table: table["case"] == case, ["group", "quantity", "fitness_percent"]]
    fitness = cells.assign(range_fitness_percent=cells["fitness_percent"] + offset, fitness_percent=90.0)
    return _found(case, variant, fitness)


def _parameters(error_percent: float = 1.0, std_percent: float = 1.0, case: str = "sp_5dof_snr50") -> pd.DataFrame:
    """Each published parameter, estimated too large by so much, among others that are in no table."""
    table = TABLE3.values.loc[lambda table: table["case"] == case, ["parameter", "true"]]
    table = pd.concat([pd.DataFrame({"parameter": ["m_1"], "true": [10.0]}), table], ignore_index=True)
    estimate, std = table["true"] * (1.0 + error_percent / 100.0), table["true"] * std_percent / 100.0
    lower, upper = estimate - 1.645 * std, estimate + 1.645 * std
    found = table.assign(estimate=estimate, error_percent=error_percent, std=std, lower_90=lower, upper_90=upper)
    return _found(case, "fixed", found)


def test_table1_agrees_with_the_paper():
    config = RunConfig.read(compose_config(["experiment=paper/sr_6dof_perturbed"]))
    true, _ = config.model_error.structures(config.structure)
    drawn = {parameter.name: parameter.prescribed for parameter in true.every_parameter()}
    parameters = TABLE1.values[["parameter"]].assign(estimate=15.0)
    parameters["true"] = [drawn[name] for name in parameters["parameter"]]
    table = compare_wrong_values(TABLE1, _found("sr_6dof_perturbed", "uncertain", parameters))
    assert list(table) == ["parameter", "prescribed", "published", "drawn", "difference", "uncertain"]
    assert len(table) == 18
    assert table["difference"].abs().max() < 0.00501
    assert "18 of 18 agree" in wrong_values_sheet(TABLE1, table).markdown


def test_without_runs_there_are_the_published_values():
    nothing = pd.DataFrame(columns=RUN)
    table = compare_wrong_values(TABLE1, nothing)
    assert table["drawn"].isna().all()
    assert "| k | prescribed | 15.00 |" in wrong_values_sheet(TABLE1, table).markdown
    assert list(compare_fitness(TABLE2, nothing)) == list(FITNESS_COLUMNS)
    assert list(compare_parameters(TABLE3, nothing)) == list(PAPER_PARAMETER_COLUMNS)


def test_fitness_is_marked_where_it_is_below():
    runs = [_fitness("sr_6dof_snr50", "uncertain", +0.5), _fitness("sr_6dof_snr50", "fixed", -0.5)]
    comparison = compare_fitness(TABLE2, pd.concat(runs))
    assert list(comparison) == list(FITNESS_COLUMNS)
    assert len(comparison) == 2 * 10
    assert comparison.groupby("variant")["below_published"].mean().to_dict() == {"uncertain": 0.0, "fixed": 1.0}
    assert comparison["difference"].abs().round(6).eq(0.5).all()
    assert set(comparison["process_seconds"]) == {5.0}
    text = fitness_sheet(TABLE2, comparison).markdown
    assert text.count("▼") == text.count("▲") == 10 + 1
    assert "|  | ours, uncertain parameters | 99.07 ▲ |" in text
    assert "|  | ours, fixed parameters, printed | 90.00 | 90.00 | 90.00 | - |" in text
    # Equal at the two decimals that the paper prints.
    assert not compare_fitness(TABLE2, _fitness("sr_6dof_snr20", "fixed", -0.004))["below_published"].any()


def test_parameters_beside_the_published_ones():
    comparison = compare_parameters(TABLE3, pd.concat(_parameters(case=case) for case in TABLE3.cases[::-1]))
    assert TABLE3.cases == [f"sp_5dof_snr{snr}" for snr in (50, 20, 10)]
    assert list(comparison) == list(PAPER_PARAMETER_COLUMNS)
    assert comparison["parameter"].tolist() == 3 * ["k_2", "k_4", "kappa_2", "kappa_4"]
    comparison = compare_parameters(TABLE3, _parameters(0.4, 0.2))
    assert comparison["larger_error"].tolist() == [False, True, False, True]  # published: 0.615, 0.37, 6.0, 0.326
    assert not comparison["truth_inside"].any()
    text = parameter_sheet(TABLE3, comparison).markdown
    assert "| k_4 | published | 15 | 14.95 | 0.37 | - |" in text
    assert "|  | ours, fixed parameters |  | 15.060 | 0.40 ▼ | 0.03 |" in text
    assert "90 % intervals that hold the true value: ours, fixed parameters, 0 of 4." in text
    assert "uncertain" not in text
    comparison = compare_parameters(TABLE3, _parameters(1.0, 1.0))
    assert comparison["truth_inside"].tolist() == [True] * 4
    assert "ours, fixed parameters, 4 of 4." in parameter_sheet(TABLE3, comparison).markdown


def test_missing_parameters_and_intervals_are_empty():
    found = _parameters().query("parameter != 'k_2'").assign(std=NAN, lower_90=NAN, upper_90=NAN)
    comparison = compare_parameters(TABLE3, found)
    assert comparison["truth_inside"].isna().all()
    text = parameter_sheet(TABLE3, comparison).markdown
    rows = [line for line in text.splitlines() if line.startswith("|  | ours")]
    assert rows[0].startswith("|  | ours, fixed parameters |  | - | - | - |")
    assert rows[1].startswith("|  | ours, fixed parameters |  | 15.15 | 1.00 ▼ | - |")
    assert "intervals" not in text


@pytest.mark.parametrize("number", range(1, 7))
def test_tables_are_written_in_three_formats(paper, number):
    place = paper / "tables"
    assert len(pd.read_csv(place / f"table{number}.csv"))
    lines = (place / f"table{number}.md").read_text().splitlines()
    assert len({line.count("|") for line in lines if line.startswith("| ")}) == 1
    check_latex((place / f"table{number}.tex").read_text())


def check_latex(text: str) -> None:
    plain = re.sub(r"\\[{}%&#_$]", "", re.sub(r"^%.*$", "", text, flags=re.MULTILINE)).replace(r"{!}{%", "{!}{")
    assert plain.count("{") == plain.count("}")
    assert "_" not in re.sub(r"\$[^$]*\$", "", plain)
    environments = re.findall(r"\\(begin|end){([a-z*]+)}", plain)
    assert environments == [("begin", "table*"), ("begin", "tabular"), ("end", "tabular"), ("end", "table*")]
    assert [plain.count(rule) for rule in (r"\toprule", r"\bottomrule")] == [1, 1]
    columns = len(re.search(r"\\begin{tabular}{([lr]+)}", plain)[1])
    for line in plain.splitlines():
        if line.endswith(r"\\"):
            spans = sum(int(span) - 1 for span in re.findall(r"\\multicolumn{(\d+)}", line))
            assert line.count("&") + 1 + spans == columns
    assert text.isascii()


def test_tables_hold_published_ours_and_smoother(paper):
    table1, table2, table6 = ((paper / "tables" / f"table{number}.md").read_text() for number in (1, 2, 6))
    assert "▲" in table1
    assert "| 6 DOFs, Duffing, no error, 50 dB | published | 98.57 | 99.30 | 99.11 | - |" in table2
    assert "|  | ours, uncertain parameters | 98.77 ▲ | 99.50 ▲ | 99.31 ▲ | - |" in table2
    assert "|  | Kalman smoother | 98.67 ▲ | 99.40 ▲ |" in table2
    assert "|  | ours, uncertain parameters, printed | 93.77 | 94.50 |" in table2
    assert "| κ_1/μ_1 | published | 100 | 99.21 | 0.79 | 0.65 | 0.75 |" in table6
    assert "ours, conditional posterior" in table6
    assert "Kalman smoother" not in table6  # it found nothing
    frame = pd.read_csv(paper / "tables" / "table1.csv")
    assert frame[["drawn", "uncertain", "kalman_smoother"]].notna().all().all()


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(("table", "count"), [("table1", 1), ("table2", 12), ("table3", 6), ("table6", 6)])
def test_a_table_alone_needs_only_its_runs(tmp_path, runner, capsys, table, count):
    assert make_table(table, tmp_path, runner) == 0
    assert len(runner.calls) == count
    assert {file.name for file in (tmp_path / "tables").iterdir()} == {
        f"{table}.{form}" for form in ("csv", "md", "tex")
    }
    assert (tmp_path / "tables" / f"{table}.md").read_text() in capsys.readouterr().out
    assert not (tmp_path / "report.html").exists()


@pytest.mark.usefixtures("quick")
def test_a_table_tells_of_the_case_that_failed(tmp_path, runner, capsys):
    runner.failing = {"sp_5dof_linear": CaseFailedError("exit status 1")}
    assert make_table("table4", tmp_path, runner) == 1
    assert set(pd.read_csv(tmp_path / "tables" / "table4.csv")["case"]) == {"sp_5dof_van_der_pol", "sp_5dof_perturbed"}
    assert "sp_5dof_linear_fixed: exit status 1" in capsys.readouterr().err


def test_symbols_and_escapes():
    assert written("kappa_2/mu_2", "latex") == r"$\kappa_{2}$/$\mu_{2}$"
    assert written("kappa_2", "html") == "<i>κ</i><sub>2</sub>"
    assert written("acceleration", "plain") == "ü"
    assert written("a_b & 5 %", "latex") == r"a\_b \& 5 \%"
    assert written("‖x − x̃‖", "latex") == r"$\|$x $-$ $\tilde{x}$$\|$"
    assert written("<b>", "html") == "&lt;b&gt;"
    assert Cell.number(math.nan, ".2f", "better").mark == ""


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
