"""The files of a sampled posterior, all together."""

from __future__ import annotations

import pandas as pd
import pytest
from fake_posteriors import LABELS, UNITS, make_findings, make_record, make_samples, true_parameters

from pinn_cli.report.bayesian_report import write_posterior


@pytest.fixture
def reported(tmp_path):
    def report(findings, record):
        text = write_posterior(findings, record, true_parameters(), LABELS, UNITS, tmp_path)
        return tmp_path, text

    return report


def test_every_file_is_written(reported):
    record = make_record()
    directory, text = reported(make_findings(make_samples(), record, "12 divergences"), record)
    names = {
        f"{name}.{kind}" for name in ("posterior_pairs", "trace", "ranks", "fitted_force") for kind in ("png", "pdf")
    }
    assert {path.name for path in (directory / "figures").iterdir()} == names
    assert {path.name for path in directory.iterdir()} == {"posterior.nc", "diagnostics.csv", "figures"}
    assert len(pd.read_csv(directory / "diagnostics.csv")) == 6
    assert "quality check FAILED: 12 divergences" in text


def test_a_posterior_in_closed_form_has_neither_traces_nor_ranks(reported):
    findings = make_findings(make_samples(statistics={}, method="laplace"))
    directory, _ = reported(findings, make_record())
    assert {path.stem for path in (directory / "figures").iterdir()} == {"posterior_pairs"}
