"""The paper's tables beside ours, with stand-ins for the runs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

from pinn_cli.report import case_runs, published, tables
from pinn_cli.report.case_runs import CaseFailedError, CaseRun, Variant, run_case
from pinn_cli.report.comparison import COLUMNS, compare_fitness, fitness_markdown
from pinn_cli.report.writing import write_json, write_table

UNCERTAIN, FIXED = tables.FITNESS_TABLES[0].variants


def _sparse_recovery() -> pd.DataFrame:
    values = published.fitness()
    return values[values["table"] == "sr-summary"]


def _fitness(case: str, offset: float) -> pd.DataFrame:
    cells = _sparse_recovery().loc[lambda table: table["case"] == case, ["group", "quantity", "fitness_percent"]]
    return cells.assign(range_fitness_percent=cells["fitness_percent"] + offset, fitness_percent=90.0)


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


def test_table2_collects_every_case_and_variant(tmp_path, monkeypatch, capsys):
    commands = []

    def run(command, **_):
        commands.append(command)
        directory = Path(command[-1].removeprefix("hydra.run.dir='").removesuffix("'"))
        case = command[3].removeprefix("experiment=paper/")
        write_table(_fitness(case, 0.1), directory / "fitness.csv")
        write_json({"seconds": {"total": 2.0}}, directory / "run.json")
        return SimpleNamespace(returncode=1 if "linear" in case else 0, stdout="", stderr="what went wrong")

    monkeypatch.setattr(subprocess, "run", run)
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


def test_tables_of_an_earlier_run_do_not_pass_for_this_one(tmp_path, monkeypatch):
    write_table(_fitness("sr_6dof_snr50", 0.0), tmp_path / "fitness.csv")
    write_json({"seconds": {"total": 2.0}}, tmp_path / "run.json")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: SimpleNamespace(returncode=0, stdout="", stderr=""))
    with pytest.raises(CaseFailedError, match=r"sr_6dof_snr50, plain: .*fitness\.csv"):
        run_case("sr_6dof_snr50", Variant("plain", "plain"), tmp_path)


def test_hydra_takes_any_folder_name():
    parser = pytest.importorskip("hydra.core.override_parser.overrides_parser").OverridesParser.create()
    for name in ("/a/b c", "/it's", "/x=1,2", "/back\\slash", "/a\\'b", "/end\\"):
        assert parser.parse_override(f"hydra.run.dir={case_runs._quoted(name)}").value() == name
