"""Which files a report writes, and what it prints, with and without unknown parameters."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from calls import SMALL
from fake_posteriors import DUFFING, make_result, make_samples
from small_estimates import parameter_estimate

from pinn_cli.cli.config import RunConfig
from pinn_cli.report import figures, run_report
from pinn_cli.report.parameters import PARAMETER_COLUMNS
from pinn_cli.report.results import LABELS, Results
from pinn_cli.runs.stages import Stages


@pytest.fixture
def reported(composed, make_case, tmp_path, monkeypatch):
    """Report the small estimate with these parameters unknown; returns the folder and the text."""
    # They are tested where they are drawn, and take seconds.
    monkeypatch.setattr(figures, "write_figures", lambda *_, **__: [])

    def report(*unknown: str, **changes: object):
        case = make_case(ndof=3, observed=2)
        parameters = [
            replace(p, parameter=replace(p.parameter, unknown=p.name in unknown, prior_std=p.prescribed))
            for p in case.estimate.parameters
        ]
        changes = {"correlation": np.eye(len(parameters)), **changes}
        estimate = replace(case.estimate, parameters=parameters, **changes)
        config = RunConfig.read(composed(*SMALL))
        results = Results(config.description, config.structure, case.record, case.truth, estimate)
        return tmp_path, run_report.write_report(results, tmp_path, Stages())

    return report


def test_unknown_parameters_bring_their_tables_and_verdict(reported):
    directory, text = reported("k_2", "kappa_2")
    table = pd.read_csv(directory / "identifiability.csv").set_index("parameter")
    assert table["std_ratio"].to_numpy() == pytest.approx(0.02)
    assert set(table["verdict"]) == {"well determined"}
    correlation = pd.read_csv(directory / "correlation.csv", index_col="parameter")
    assert list(correlation) == list(correlation.index) == list(table.index)
    assert text.splitlines()[2].startswith("k_2 *")
    assert "every unknown parameter is well determined" in text


def test_prescribed_parameters_alone_bring_none(reported):
    directory, text = reported()
    assert not list(directory.glob("identifiability*"))
    assert not list(directory.glob("correlation*"))
    assert "*" not in text.split("\n\n")[0]


def test_a_training_without_correlation_writes_no_matrix(reported):
    directory, _ = reported("k_2", correlation=None)
    assert (directory / "identifiability.csv").is_file()
    assert not (directory / "correlation.csv").exists()


@pytest.mark.parametrize("unknown", [(), ("k_2",)])
def test_the_columns_of_parameters_csv_are_agreed(reported, unknown):
    directory, _ = reported(*unknown)
    assert list(pd.read_csv(directory / "parameters.csv")) == [*LABELS, *PARAMETER_COLUMNS]


def test_a_posterior_brings_its_files_parameters_and_verdict(composed, make_case, tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "write_figures", lambda *_, **__: [])
    case = make_case(ndof=3, observed=3)
    start = [parameter_estimate(name, 1.0, 1.0, 0.1, 0.9, 1.1) for name in DUFFING]
    samples = make_samples()
    posterior = make_result(samples, None, "3 divergences")
    config, estimate = RunConfig.read(composed(*SMALL)), replace(case.estimate, parameters=start)
    results = Results(config.description, config.structure, case.record, case.truth, estimate, posterior=posterior)
    text = run_report.write_report(results, tmp_path, Stages())
    table = pd.read_csv(tmp_path / "parameters.csv").set_index("parameter")
    assert table["estimate"].to_numpy() == pytest.approx(samples.draws.mean(axis=(0, 1)))
    assert (tmp_path / "posterior.nc").is_file()
    assert (tmp_path / "figures" / "posterior_pairs.png").is_file()
    assert "quality check FAILED: 3 divergences" in text
    record = json.loads((tmp_path / "run.json").read_text())["posterior"]
    assert (record["method"], record["chains"], record["quality_check"]) == ("marginal", 4, ["3 divergences"])
