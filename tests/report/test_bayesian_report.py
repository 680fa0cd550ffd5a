"""The files of a sampled posterior, all together."""

from __future__ import annotations

import pandas as pd
import pytest
from fake_posteriors import LABELS, make_record, make_result, make_samples, parameters_of, true_parameters

from pinn_cli.record.record import Truth
from pinn_cli.record.response import Response
from pinn_cli.report.results import Results, RunDescription
from pinn_cli.report.run_report import write_posterior
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing
from pinn_cli.training.estimate import Estimate, ParameterEstimate


@pytest.fixture
def reported(tmp_path):
    def report(posterior, record):
        run = RunDescription("pe", 0, "cpu", 1, "", LABELS, True, "none", "none")
        truth = Truth(Response.unknown(record.time, 2), true_parameters())
        parameters = [ParameterEstimate(parameter, 1.0) for parameter in parameters_of(posterior.samples)]
        estimate = Estimate(truth.response, truth.response, parameters, pd.DataFrame(), {})
        chain = build_chain(2, Duffing(), m=1.0, c=1.0, k=15.0, kappa=100.0)
        results = Results(run, chain, record, truth, estimate, posterior=posterior)
        write_posterior(results, tmp_path, figures=True)
        return tmp_path

    return report


def test_every_file_is_written(reported):
    record = make_record()
    directory = reported(make_result(make_samples(), record, "12 divergences"), record)
    names = {
        f"{name}.{kind}" for name in ("posterior_pairs", "trace", "ranks", "fitted_force") for kind in ("png", "pdf")
    }
    assert {path.name for path in (directory / "figures").iterdir()} == names
    assert {path.name for path in directory.iterdir()} == {"posterior.nc", "diagnostics.csv", "figures"}
    assert len(pd.read_csv(directory / "diagnostics.csv")) == 6


def test_a_posterior_in_closed_form_has_neither_traces_nor_ranks(reported):
    posterior = make_result(make_samples(statistics={}, method="laplace"))
    directory = reported(posterior, make_record())
    assert {path.stem for path in (directory / "figures").iterdir()} == {"posterior_pairs"}
