"""Estimates from draws, and what is printed of how they were sampled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from fake_posteriors import CORRELATION, DUFFING, LABELS, make_diagnostics, make_samples, true_parameters
from small_estimates import parameter_estimate

from pinn_cli.report.parameters import parameter_table
from pinn_cli.report.posterior import (
    DIAGNOSTICS,
    diagnostics_table,
    parameter_estimates,
    posterior_correlation,
    worst_sampled,
)
from pinn_cli.report.results import LABELS as LABEL_NAMES
from pinn_cli.report.terminal.columns import WIDTH
from pinn_cli.report.terminal.parameters import PARAMETERS_SHOWN, diagnostics_text
from pinn_cli.system.parameters import Parameter

MANY = [f"{symbol}_{i}" for symbol in ("c", "k", "kappa") for i in range(1, 11)]


def test_estimates_of_known_draws():
    draws = np.arange(1.0, 102.0).reshape(1, 101, 1)
    samples = replace(make_samples(("k_1",)), draws=draws, prior=np.array([[0.0], [2.0], [4.0]]))
    (k,) = parameter_estimates(samples, [Parameter("k", 0, 7.0)])
    assert (k.name, k.prescribed, k.unknown) == ("k_1", 7.0, True)
    assert (k.estimate, k.lower_90, k.upper_90) == pytest.approx((51.0, 6.0, 96.0))
    assert k.std == pytest.approx(np.std(draws, ddof=1))
    assert k.prior_std == pytest.approx(2.0)


def test_estimates_make_the_parameter_table():
    estimates = parameter_estimates(
        make_samples(), [parameter_estimate(name, 1.0, 1, 1, 1, 1).parameter for name in DUFFING]
    )
    table = parameter_table(estimates, true_parameters(), LABELS).set_index("parameter")
    assert list(table.index) == list(DUFFING)
    assert (table["error_percent"] < 1.0).all()
    assert (table["lower_90"] < table["estimate"]).all()
    assert (table["estimate"] < table["upper_90"]).all()


def test_correlation():
    correlation = posterior_correlation(make_samples().pooled)
    assert correlation[2, 4] == pytest.approx(CORRELATION, abs=0.03)
    assert abs(correlation[0, 1]) < 0.1
    np.testing.assert_array_equal(np.diag(correlation), 1.0)
    np.testing.assert_array_equal(correlation, correlation.T)


def test_correlation_beside_a_parameter_that_does_not_move():
    draws = make_samples().draws.copy()
    draws[..., 0] = 1.0
    correlation = posterior_correlation(draws.reshape(-1, draws.shape[-1]))
    assert np.isnan(correlation[0, 1:]).all()
    assert np.isfinite(correlation[1:, 1:]).all()


def test_diagnostics_csv_has_the_labels_in_front():
    table = diagnostics_table(make_diagnostics(make_samples()).assign(more=1), LABELS)
    assert list(table) == [*LABEL_NAMES, *DIAGNOSTICS]


def test_the_worst_sampled_keep_their_order():
    diagnostics = make_diagnostics(make_samples()).assign(ess_tail=[900.0, 800.0, 10.0, 900.0, 20.0, 900.0])
    assert worst_sampled(diagnostics, 3) == ["c_1", "k_1", "kappa_1"]
    assert worst_sampled(diagnostics, 9) == list(DUFFING)


@pytest.mark.parametrize("names", [("k_1",), DUFFING, MANY], ids=len)
def test_the_printed_table_fits(names):
    diagnostics = make_diagnostics(make_samples(names, draws=50))
    diagnostics.loc[0, ["mean", "std", "lower_90", "upper_90"]] = [-1.2345e12, 3.2e-12, -1.2345e12, -1.2345e-12]
    text = diagnostics_text(diagnostics, ["R-hat of k_1 is 1.03, and the chains have not mixed; draw more, " * 3])
    lines = text.splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert lines[0].split() == [
        "parameter",
        "mean",
        "std",
        "90",
        "%",
        "interval",
        "R-hat",
        "bulk",
        "ESS",
        "tail",
        "ESS",
        "MCSE",
    ]


def test_the_printed_row():
    row = diagnostics_text(make_diagnostics(make_samples())).splitlines()[4]
    cells = row.split()
    assert cells[0] == "k_1"
    assert cells[1].startswith(("14.9", "15.0"))
    assert cells[-4:-1] == ["1.002", "1620", "1520"]


def test_the_verdict_is_visible():
    diagnostics = make_diagnostics(make_samples())
    assert diagnostics_text(diagnostics).splitlines()[-1] == "quality check of the sampling passed"
    last = diagnostics_text(diagnostics, ("bulk ESS of c_1 is 120, below 400", "3 divergences")).splitlines()[-2:]
    assert last == [
        "! quality check FAILED: bulk ESS of c_1 is 120, below 400",
        "! quality check FAILED: 3 divergences",
    ]


def test_many_parameters_show_the_worst_sampled():
    text = diagnostics_text(make_diagnostics(make_samples(MANY, draws=50)))
    assert f"the {PARAMETERS_SHOWN} of 30 with the fewest effective draws; all: diagnostics.csv" in text
    assert "kappa_10" not in text
    assert "\nc_1 " in text


def test_without_chains_there_is_nothing_to_check():
    unknown = dict.fromkeys(["r_hat", "ess_bulk", "ess_tail", "mcse_mean"], np.nan)
    text = diagnostics_text(pd.DataFrame(make_diagnostics(make_samples()).assign(**unknown)))
    assert text.splitlines()[2].split()[-4:] == ["-"] * 4
    assert "no chains" in text
