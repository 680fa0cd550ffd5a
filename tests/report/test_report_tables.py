"""The paper's tables beside ours, with stand-ins for the runs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

from pinn_cli.paper import single_tables as tables
from pinn_cli.paper.case_runs import CaseFailedError, CaseRun, Variant, run_case
from pinn_cli.paper.comparison import COLUMNS, compare_fitness, fitness_markdown
from pinn_cli.paper.parameter_comparison import COLUMNS as PARAMETER_COLUMNS
from pinn_cli.paper.parameter_comparison import compare_parameters, parameters_markdown
from pinn_cli.report import published
from pinn_cli.runs.writing import write_json, write_table
from pinn_cli.settings.override_syntax import quoted

UNCERTAIN, FIXED = tables.FITNESS_TABLES[0].variants
NAN = float("nan")


def _sparse_recovery() -> pd.DataFrame:
    values = published.fitness()
    return values[values["table"] == "sr-summary"]


def _fitness(case: str, offset: float) -> pd.DataFrame:
    cells = published.fitness().loc[lambda table: table["case"] == case, ["group", "quantity", "fitness_percent"]]
    return cells.assign(range_fitness_percent=cells["fitness_percent"] + offset, fitness_percent=90.0)


def _parameters(case: str, error_percent: float = 1.0, std_percent: float = 1.0) -> pd.DataFrame:
    """Each published parameter, estimated too large by so much, among others that are in no table."""
    table = published.parameters().loc[lambda table: table["case"] == case, ["parameter", "true"]]
    table = pd.concat([pd.DataFrame({"parameter": ["m_1"], "true": [10.0]}), table], ignore_index=True)
    estimate, std = table["true"] * (1.0 + error_percent / 100.0), table["true"] * std_percent / 100.0
    lower, upper = estimate - 1.645 * std, estimate + 1.645 * std
    return table.assign(estimate=estimate, error_percent=error_percent, std=std, lower_90=lower, upper_90=upper)


def test_table1_agrees_with_the_paper(tmp_path, capsys):
    assert tables.main(["table1", "--output", str(tmp_path)]) == 0
    table = pd.read_csv(tmp_path / "table1.csv")
    assert len(table) == 18
    assert table["difference"].abs().max() < 0.00501
    assert "18 of 18 agree" in (tmp_path / "table1.md").read_text()
    assert "kappa_6" in capsys.readouterr().out


def test_comparison_marks_what_is_below():
    runs = [CaseRun("sr_6dof_snr50", "uncertain", _fitness("sr_6dof_snr50", +0.5), 3.0, 5.0)]
    runs += [CaseRun("sr_6dof_snr50", "fixed", _fitness("sr_6dof_snr50", -0.5), 3.0, 5.0)]
    comparison = compare_fitness(_sparse_recovery(), runs)
    assert list(comparison) == list(COLUMNS)
    assert len(comparison) == 2 * 10
    assert comparison.groupby("variant")["below_published"].mean().to_dict() == {"uncertain": 0.0, "fixed": 1.0}
    assert comparison["difference"].abs().round(6).eq(0.5).all()
    text = fitness_markdown("Title", comparison, (UNCERTAIN, FIXED))
    assert text.count("▼") == 10 + 1
    assert "| sr_6dof_snr50 | published | 98.57 | 99.30 | 99.11 |  |" in text
    assert "|  | uncertain parameters, range | 99.07 (+0.50) |" in text
    assert "|  | fixed parameters, printed | 90.00 | 90.00 | 90.00 |  |" in text


def test_equal_at_the_papers_two_decimals_is_not_below():
    comparison = compare_fitness(
        _sparse_recovery(), [CaseRun("sr_6dof_snr20", "fixed", _fitness("sr_6dof_snr20", -0.004), 1.0, 1.0)]
    )
    assert not comparison["below_published"].any()


@pytest.fixture
def commands(monkeypatch):
    """Stand-ins for the runs, of which those with a linear model fail; the commands that were to be run."""
    commands = []

    def run(command, **_):
        commands.append(command)
        directory = Path(command[-1].removeprefix("hydra.run.dir='").removesuffix("'"))
        case = command[3].removeprefix("experiment=paper/")
        write_table(_fitness(case, 0.1), directory / "fitness.csv")
        write_table(_parameters(case), directory / "parameters.csv")
        write_json({"seconds": {"total": 2.0}}, directory / "run.json")
        return SimpleNamespace(returncode=1 if "linear" in case else 0, stdout="", stderr="what went wrong")

    monkeypatch.setattr(subprocess, "run", run)
    return commands


def test_table2_collects_every_case_and_variant(tmp_path, commands, capsys):
    assert tables.main(["table2", "--output", str(tmp_path / "a folder, with = signs")]) == 1
    assert len(commands) == 12
    assert commands[0][:4] == [sys.executable, "-m", "pinn_cli.main", "experiment=paper/sr_6dof_snr50"]
    assert commands[1][4] == "scheme.parameter_uncertainty=0"
    written = tmp_path / "a folder, with = signs"
    table = pd.read_csv(written / "table2.csv")
    assert len(table) == 5 * 2 * 10
    assert set(table["seconds"]) == {2.0}
    assert "sr_6dof_linear, fixed parameters: exit status 1" in (written / "table2.md").read_text()
    assert "what went wrong" in capsys.readouterr().err


def test_table5_has_the_groups_of_the_state_parameter_scheme(tmp_path, commands):
    assert tables.main(["table5", "--output", str(tmp_path)]) == 1
    assert len(commands) == 12
    table = pd.read_csv(tmp_path / "table5.csv")
    assert table["group"].unique().tolist() == ["all", "observed", "unobserved"]
    text = (tmp_path / "table5.md").read_text()
    assert "## Unobserved DOFs" in text
    assert "sp_5dof_linear, uncertain parameters: exit status 1" in text


def test_table3_collects_the_parameters_of_three_noise_levels(tmp_path, commands):
    assert tables.main(["table3", "--output", str(tmp_path)]) == 0
    assert [command[3].removeprefix("experiment=paper/") for command in commands[::2]] == [
        f"sp_5dof_snr{snr}" for snr in (50, 20, 10)
    ]
    assert all(command[4] == "scheme.parameter_uncertainty=0" for command in commands[1::2])
    table = pd.read_csv(tmp_path / "table3.csv")
    assert list(table) == list(PARAMETER_COLUMNS)
    assert len(table) == 3 * 4 * 2
    assert set(table["parameter"]) == {"k_2", "k_4", "kappa_2", "kappa_4"}
    text = (tmp_path / "table3.md").read_text()
    assert text.index("## Uncertain parameters") < text.index("## Fixed parameters")


def test_table4_tells_of_the_case_that_failed(tmp_path, commands):
    assert tables.main(["table4", "--output", str(tmp_path)]) == 1
    assert set(pd.read_csv(tmp_path / "table4.csv")["case"]) == {"sp_5dof_van_der_pol", "sp_5dof_perturbed"}
    assert "sp_5dof_linear, fixed parameters: exit status 1" in (tmp_path / "table4.md").read_text()


def test_table6_compares_three_posteriors(tmp_path, commands):
    assert tables.main(["table6", "--output", str(tmp_path)]) == 0
    cases = ["pe_2dof_duffing", "pe_2dof_van_der_pol"]
    assert [command[3].removeprefix("experiment=paper/") for command in commands] == [
        c for c in cases for _ in range(3)
    ]
    assert [command[4] for command in commands[1:3]] == ["posterior=conditional", "posterior=laplace"]
    assert commands[0][4].startswith("hydra.run.dir=")
    table = pd.read_csv(tmp_path / "table6.csv")
    assert len(table) == 2 * 6 * 3
    assert table.loc[0, ["published", "published_error_percent", "published_std"]].tolist() == [0.984, 1.6, 0.03]
    text = (tmp_path / "table6.md").read_text()
    assert text.count("| case | parameter | true | published | error | std | ours | error | std |") == 3
    assert "| pe_2dof_duffing | c_1 | 1 | 0.984 | 1.6 | 0.03 | 1.010 | 1.00 | 0.01 | 0.994 to 1.026 | yes |" in text
    assert text.index("## Marginal") < text.index("## Conditional") < text.index("## Laplace")
    assert "Seconds: pe_2dof_duffing" in text


def _table3_row(text: str, parameter: str) -> list[str]:
    (line,) = [line for line in text.splitlines() if f"| {parameter} |" in line]
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_parameters_beside_the_published_ones():
    run = CaseRun("sp_5dof_snr50", "fixed", pd.DataFrame(), 3.0, 5.0, _parameters("sp_5dof_snr50", 0.4, 0.2))
    comparison = compare_parameters(published.parameters(), [run])
    assert comparison["larger_error"].tolist() == [False, True, False, True]  # published: 0.615, 0.37, 6.0, 0.326
    assert not comparison["truth_inside"].any()
    text = parameters_markdown("Title", comparison, (UNCERTAIN, FIXED))
    cells = ["", "k_4", "15", "14.95", "0.37", "15.060", "0.40 ▲", "0.03", "15.011 to 15.109", "no"]
    assert _table3_row(text, "k_4") == cells
    assert "2 of 4 errors are larger than the published ones; 0 of 4 intervals hold the truth" in text
    assert "sp_5dof_snr50 5.0" in text
    assert "Uncertain" not in text


def test_an_interval_that_holds_the_truth():
    run = CaseRun("sp_5dof_snr50", "fixed", pd.DataFrame(), 3.0, 5.0, _parameters("sp_5dof_snr50", 1.0, 1.0))
    comparison = compare_parameters(published.parameters(), [run])
    assert comparison["truth_inside"].tolist() == [True] * 4
    assert _table3_row(parameters_markdown("Title", comparison, (FIXED,)), "kappa_2")[-1] == "yes"


def test_missing_parameters_and_intervals_are_empty():
    parameters = _parameters("sp_5dof_snr50").query("parameter != 'k_2'").assign(std=NAN, lower_90=NAN, upper_90=NAN)
    run = CaseRun("sp_5dof_snr50", "fixed", pd.DataFrame(), 3.0, 5.0, parameters)
    comparison = compare_parameters(published.parameters(), [run])
    assert comparison["truth_inside"].isna().all()
    text = parameters_markdown("Title", comparison, (FIXED,))
    assert _table3_row(text, "k_2") == ["sp_5dof_snr50", "k_2", "-", "14.91", "0.615", "-", "-", "-", "-", "-"]
    assert _table3_row(text, "k_4")[-3:] == ["-", "-", "-"]
    assert "0 of 0 intervals" in text


def test_tables_of_an_earlier_run_do_not_pass_for_this_one(tmp_path, monkeypatch):
    write_table(_fitness("sr_6dof_snr50", 0.0), tmp_path / "fitness.csv")
    write_table(_parameters("sr_6dof_snr50"), tmp_path / "parameters.csv")
    write_json({"seconds": {"total": 2.0}}, tmp_path / "run.json")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: SimpleNamespace(returncode=0, stdout="", stderr=""))
    with pytest.raises(CaseFailedError, match=r"sr_6dof_snr50, plain: .*fitness\.csv"):
        run_case("sr_6dof_snr50", Variant("plain", "plain"), tmp_path)


def test_hydra_takes_any_folder_name():
    parser = pytest.importorskip("hydra.core.override_parser.overrides_parser").OverridesParser.create()
    for name in ("/a/b c", "/it's", "/x=1,2", "/back\\slash", "/a\\'b", "/end\\"):
        assert parser.parse_override(f"hydra.run.dir={quoted(name)}").value() == name
