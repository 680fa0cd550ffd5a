"""Noise seeds and nonlinearity in the report: there once their results are, and evidence for what stays behind."""

from __future__ import annotations

import pandas as pd
import pytest
from fake_solver import FakeSolver

from pinn_cli.paper.commands import make_all, make_seeds
from pinn_cli.paper.shortfalls import _over_seeds


def test_other_draws_tell_luck_from_fault():
    summary = pd.DataFrame({"case": "c", "estimator": ["pinn", "kalman_smoother"], "mean": [99.0, 99.4], "seeds": 10})
    assert "this draw is unlucky" in _over_seeds(summary, {"case": "c"}, "mean", 98.9)
    assert "the noise allows it" in _over_seeds(summary, {"case": "c"}, "mean", 99.2)
    assert "not reached on average by either" in _over_seeds(summary, {"case": "c"}, "mean", 99.9)
    assert _over_seeds(summary, {"case": "other"}, "mean", 99.0) == ""
    assert _over_seeds(pd.DataFrame(), {"case": "c"}, "mean", 99.0) == ""
    errors = summary.assign(mean=[1.0, 2.0])
    assert "mean error is 1.00 %" in _over_seeds(errors, {"case": "c"}, "mean", -1.5)
    assert "this draw is unlucky" in _over_seeds(errors, {"case": "c"}, "mean", -1.5)
    assert "not reached" in _over_seeds(errors, {"case": "c"}, "mean", -0.5)


def test_the_report_shows_both(paper):
    text = (paper / "report.html").read_text(encoding="utf-8")
    assert 'id="seeds_table2"' in text
    assert 'id="nonlinearity-figure"' in text
    assert text.count("120 records, each estimated by both, in 300 s") == 2
    assert "Over 10 other draws our mean error is 1.00 %" in text
    assert (paper / "seeds" / "seeds_table2.tex").exists()
    assert (paper / "nonlinearity" / "nonlinearity.pdf").exists()


@pytest.mark.usefixtures("quick_digests")
def test_seeds_alone_leave_the_report_to_the_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("pinn_cli.paper.robustness.scored._settings_digest", "".join)
    monkeypatch.setattr("pinn_cli.paper.robustness.noise_seeds.SEEDS", 1)
    solver = FakeSolver()
    solver.refused = {"sr_6dof_linear_seed0"}
    assert make_seeds(tmp_path, solver) == 1
    assert "waits for runs" in capsys.readouterr().out
    assert not (tmp_path / "report.html").exists()


def test_all_makes_the_three(tmp_path, monkeypatch):
    made = []
    for name, status in (("make_paper", 0), ("make_seeds", 1), ("make_nonlinearity", 0)):
        monkeypatch.setattr(
            f"pinn_cli.paper.commands.{name}", lambda output, n=name, s=status: made.append((n, output)) or s
        )
    assert make_all(tmp_path) == 1
    assert made == [(name, tmp_path) for name in ("make_paper", "make_seeds", "make_nonlinearity")]
