"""The figures and the report that `make paper` leaves behind, from made-up runs and scores."""

import math
import re

import pandas as pd
import pytest
from html_pages import Checked

from pinn_cli.paper.__main__ import main, make_figures, make_paper, make_seeds
from pinn_cli.paper.report import copy_figures, fitness_reason, over_seeds, paper_figures, parameter_reason
from pinn_cli.paper.runs import CaseFailedError


def test_the_report_is_well_formed_loads_nothing_and_says_what_was_run(paper):
    text = (paper / "report.html").read_text(encoding="utf-8")
    checked = Checked(text)
    assert text.count("<img") == len(paper_figures()) + 1 == 15
    assert [place.partition(";")[0] for place in checked.loaded] == ["data:image/svg+xml"] * 3 + ["data:image/png"] * 12
    assert len(checked.ids) == len(set(checked.ids))
    assert {link.removeprefix("#") for link in checked.links} <= set(checked.ids)
    assert "url(" not in text
    assert "@import" not in text
    assert "nan" not in re.sub(r"base64,[^\"]*", "", text)
    assert str(paper.parent) not in text
    assert all(
        told in text
        for told in (
            "30 runs, 150 s", "numpy", "no estimate of pe_2dof_duffing, pe_2dof_van_der_pol",
            "sp_5dof_snr10, k_2",  # 0.8 % off where 0.145 % is published
            "36 records, each estimated by both, in 90 s", "24 records, each estimated by both, in 60 s",
            "Over 3 other draws our mean error is 1.00 %", 'id="seeds_table2"', 'id="nonlinearity-figure"',
        )
    )  # fmt: skip
    assert "Barely identifiable" not in text
    assert (paper / "seeds" / "seeds_table2.tex").exists()
    names = {f"figure{number:02d}.{'svg' if number < 4 else 'png'}" for number in range(1, 15)}
    names |= {f"figure{number:02d}.pdf" for number in range(1, 15)}
    assert {file.name for file in (paper / "figures").iterdir()} == names
    starts = {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}
    assert all(file.read_bytes().startswith(starts[file.suffix]) for file in (paper / "figures").iterdir())
    run = paper / "runs" / "sr_20dof_snr50_uncertain" / "figures"
    assert (paper / "figures" / "figure06.png").read_bytes() == (run / "error_map.png").read_bytes()


@pytest.mark.usefixtures("quick")
def test_figures_alone_need_only_their_runs(tmp_path, runner):
    assert make_figures(tmp_path, runner) == 0
    assert len(runner.calls) == len({figure.run for figure in paper_figures() if figure.run}) == 10
    assert not (tmp_path / "report.html").exists()
    assert list(copy_figures([], tmp_path)) == [1, 2, 3]


@pytest.mark.usefixtures("quick")
def test_failed_cases_and_values_that_are_worse_are_told(tmp_path, runner):
    runner.failing = {"sr_20dof_snr50": CaseFailedError("exit status 3")}
    runner.offset = -0.2
    assert make_paper(tmp_path, runner) == 1
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "sr_20dof_snr50_fixed: exit status 3" in text
    assert "Not drawn: the run sr_20dof_snr50_uncertain is missing" in text
    assert "sr_6dof_snr50, All DOFs, displacement" in text
    assert "The smoother reaches 98.47 % on the same record" in text
    Checked(text)


def test_reasons_tell_record_method_and_luck_apart():
    assert len({fitness_reason(95.0, smoother).rpartition(":")[2] for smoother in (95.05, 97.0, math.nan)}) == 3
    row = {"case": "sp_5dof_snr10", "parameter": "kappa_2", "std": 25.0, "true": 100.0, "estimate": 56.0}
    cases = ({}, {"case": "sp_5dof_linear"}, {"parameter": "k_2", "truth_inside": True}, {"parameter": "k_2"})
    reasons = [parameter_reason({**row, "truth_inside": False, **case}) for case in cases]
    assert len(set(reasons)) == 4
    assert "1.8 standard deviations" in reasons[-1]
    summary = pd.DataFrame({"case": "c", "estimator": ["pinn", "kalman_smoother"], "mean": [99.0, 99.4], "seeds": 10})
    told = [over_seeds(summary, {"case": "c"}, "mean", wanted) for wanted in (98.9, 99.2, 99.9)]
    assert len({text.rpartition(":")[2] for text in told}) == 3
    errors = summary.assign(mean=[1.0, 2.0])
    off, near = (over_seeds(errors, {"case": "c"}, "mean", wanted) for wanted in (-0.5, -1.5))
    assert "1.00 %" in off
    assert (off.rpartition(":")[2], near.rpartition(":")[2]) == tuple(t.rpartition(":")[2] for t in told[::-2])
    assert over_seeds(summary, {"case": "other"}, "mean", 99.0) == over_seeds(pd.DataFrame(), {}, "mean", 99.0) == ""


@pytest.mark.usefixtures("quick")
def test_seeds_alone_leave_the_report_to_the_runs(tmp_path, capsys, solver):
    solver.refused = {"sr_6dof_linear_seed0"}
    assert make_seeds(tmp_path, solver) == 1
    assert "waits for runs" in capsys.readouterr().out
    assert not (tmp_path / "report.html").exists()


def test_an_interrupt_ends_with_130(tmp_path, monkeypatch, capsys):
    def interrupted(*_, at_once):
        raise KeyboardInterrupt

    monkeypatch.setattr("pinn_cli.paper.__main__.make_runs", interrupted)
    assert main(["figures", "--output", str(tmp_path)]) == 130
    assert "goes on" in capsys.readouterr().err
