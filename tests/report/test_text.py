"""The tables of both estimators, and what a run prints: it fits 100 columns and says what it leaves out."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from fake_posteriors import DUFFING, make_diagnostics, make_samples
from small_estimates import parameter_estimate, results_of

from pinn_cli.record.response import Response
from pinn_cli.report.fitness import fitness_table, published, published_fitness_of, residual_table
from pinn_cli.report.free_run import FreeRun, free_run_table
from pinn_cli.report.parameters import parameter_table
from pinn_cli.report.results import with_labels
from pinn_cli.report.run_report import estimator_tables
from pinn_cli.report.text import (
    PARAMETERS_SHOWN,
    WIDTH,
    Column,
    comparison_text,
    diagnostics_text,
    fitness_text,
    free_run_line,
    parameters_text,
    sensors_text,
    stories_text,
    table_lines,
)
from pinn_cli.training.estimate import ParameterEstimate, Story
from pinn_cli.training.noise_model import FoundNoise

MANY = [f"{symbol}_{i}" for symbol in ("c", "k", "kappa") for i in range(1, 11)]


def tables(case, name="pinn", estimate=None) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Fitness and parameters."""
    return estimator_tables(name, results_of(case).run, estimate or case.estimate, case.record, case.truth)


def residuals(case, name="pinn", estimate=None):
    return with_labels(residual_table(estimate or case.estimate, case.record), results_of(case).run.labels_of(name))


def fits(text: str) -> bool:
    return max(map(len, text.splitlines())) <= WIDTH


@pytest.mark.parametrize("worse", [1.0, -1e6])
def test_the_text_compares_both(make_case, worse):
    case = make_case(ndof=6)
    response = replace(case.estimate.response, displacement=worse * case.estimate.response.displacement)
    theirs = tables(case, "kalman_smoother", replace(case.estimate, response=response))
    text = comparison_text(tables(case)[0], theirs[0], {"estimate": 1.26, "baseline": 12.0})
    assert fits(text)
    rows = [line.split() for line in text.splitlines()[-2:]]
    assert [(row[0], row[-1]) for row in rows] == [("pinn", "1.3"), ("kalman_smoother", "12.0")]


@pytest.mark.parametrize("ndof", [1, 6, 20])
def test_fitness_and_parameters_fit(ndof, make_case):
    case = make_case(ndof=ndof, observed=1)
    text = fitness_text(tables(case)[0], case.record.observed, published("fitness"))
    assert fits(text)
    assert ("fitness.csv" in text) == (ndof > 10)
    text = parameters_text(tables(case)[1])
    assert fits(text)
    assert ("the 24 of 60" in text) == (ndof == 20)


def test_published_rows_of_this_case_only(make_case):
    case = make_case()
    labels = case.labels | {"case": "sr_6dof_snr50"}
    assert fitness_text(tables(case)[0], published=published_fitness_of(labels)).count("published") == 3
    for other in ({"case": "small"}, {"ndof": 7}, {"snr_db": 20.0}):
        assert published_fitness_of(labels | other).empty


def test_of_held_out_sensors_only_what_can_be_scored_is_printed(make_case):
    case = make_case(ndof=3, observed=2)
    unknown = Response.unknown(case.record.time, 3)
    table = fitness_table(case.estimate.response, unknown, case.record.observed)
    assert fitness_text(table) == ""
    held_out = np.where([False, False, True], case.truth.response.acceleration, np.nan)
    table = fitness_table(case.estimate.response, replace(unknown, acceleration=held_out), case.record.observed)
    lines = fitness_text(table, case.record.observed).splitlines()
    assert lines[1].split() == ["DOFs", "accel.", "accel."]
    assert [line.split()[:2] for line in lines[3:-1]][-1] == ["dof_3", "*"]
    assert [line.split()[0] for line in lines[3:-1]] == ["all", "last", "unobserved", "dof_3"]


def identified(count: int = 2) -> list[ParameterEstimate]:
    """Every second parameter of two kinds is unknown; of the prescribed ones, the last moved furthest."""
    return [
        parameter_estimate(f"{kind}_{i}", 10.0, 10.0 + i, 0.1, 9.0 + i, 11.0 + i, 5.0, unknown=i % 2 == 0)
        for kind in ("k", "kappa")
        for i in range(1, 2 * count + 1)
    ]


def test_unknown_parameters_come_first_and_are_marked():
    lines = parameters_text(parameter_table(identified())).splitlines()
    names = [line.split("  ")[0] for line in lines]
    assert names[2:6] == ["k_2 *", "k_4 *", "kappa_2 *", "kappa_4 *"]
    assert lines[0].split()[:3] == ["parameter", "start", "estimate"]
    assert lines[7].split()[:3] == ["parameter", "prescribed", "estimate"]
    assert names[9:13] == ["k_1", "k_3", "kappa_1", "kappa_3"]
    assert parameters_text(parameter_table([])) == ""
    # Of many all that are unknown are shown, and a handful of the others.
    lines = parameters_text(parameter_table(identified(count=20))).splitlines()
    assert sum(" * " in line for line in lines) == 40
    assert next(line.split()[0] for line in lines[42:] if line.startswith("k")) == "k_33"
    assert len([line for line in lines[42:] if line.startswith("k")]) == 8


def test_warnings_are_counted_and_fit():
    warnings = [f"k_{i} " + "can hardly be told from the others " * 3 for i in range(15)]
    text = parameters_text(parameter_table(identified()), warnings)
    assert text.count("! ") == 12 + 1
    assert "3 more" in text.splitlines()[-1]
    assert fits(text)


def test_a_baselines_parameters_stand_beside_ours_where_there_is_no_truth():
    theirs = parameter_table([replace(p, estimate=77.0, std=0.5) for p in identified()])
    other = theirs.assign(estimator="kalman_smoother")
    text = parameters_text(parameter_table(identified()), baseline=other)
    assert text.splitlines()[2].split()[-2:] == ["77.000", "0.50"]
    assert fits(text)
    known = parameter_table(identified(), {"k": np.ones(4), "kappa": np.ones(4)})
    assert "kalman_smoother" not in parameters_text(known, baseline=other)


def test_sensors_have_a_line_each_with_units_and_no_dashes(make_case):
    lines = sensors_text([[residuals(make_case(ndof=3, observed=2))]]).splitlines()
    units = [["acceleration", "1", "m/s^2"], ["acceleration", "2", "m/s^2"], ["force", "1", "N"]]
    assert [line.split()[:3] for line in lines[2:5]] == units
    assert all(word not in line for word in ("noise:", "noise ", "free run") for line in lines)
    assert all(cell != "-" for line in lines[2:5] for cell in line.split())


def test_sensors_beside_a_baseline_fit_and_of_many_the_worst_are_shown(make_case):
    case = make_case(ndof=40, observed=40)
    estimate = replace(case.estimate, noise=FoundNoise(dict.fromkeys(("acceleration", "force"), np.full(40, 1e-7))))
    text = sensors_text([[residuals(case, name, estimate) for name in ("pinn", "other")]], "kalman_smoother")
    assert fits(text)
    assert "kalman_smoother (%)" in text
    assert sum(line.startswith(("acceleration", "force")) for line in text.splitlines()) == 24


def test_columns_never_meet():
    columns = {"name": Column("name", -3), "x": Column("x", 4), "y": Column("y", 5)}
    lines = table_lines(columns, pd.DataFrame({"name": ["long_name"], "x": ["11.8"], "y": ["0.000533"]}))
    assert lines[2].split() == ["long_name", "11.8", "0.000533"]
    assert len(lines[0]) == len(lines[1]) == len(lines[2])


def test_a_free_run_in_a_sentence(make_case):
    case = make_case(ndof=2)
    run = FreeRun(case.estimate.response)
    table = free_run_table(run, case.estimate, case.record, Response.unknown(case.record.time, 2))
    assert "100.00 %" in free_run_line(run, table)
    assert free_run_line(FreeRun(None, "no force"), table) == "no force"


@pytest.mark.parametrize("names", [("k_1",), DUFFING, MANY], ids=len)
def test_the_printed_diagnostics_fit_and_show_the_worst_of_many(names):
    diagnostics = make_diagnostics(make_samples(names, draws=50))
    diagnostics.loc[0, ["mean", "std", "lower_90", "upper_90"]] = [-1.2345e12, 3.2e-12, -1.2345e12, -1.2345e-12]
    lines = diagnostics_text(diagnostics, ["R-hat of k_1 is 1.03, and the chains have not mixed " * 3]).splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert sum(line.split()[0] in names for line in lines) == min(len(names), PARAMETERS_SHOWN)
    assert any("diagnostics.csv" in line for line in lines) == (len(names) > PARAMETERS_SHOWN)


def test_what_is_printed_of_the_sampling():
    diagnostics = make_diagnostics(make_samples())
    text = diagnostics_text(diagnostics)
    assert text.splitlines()[4].split()[-4:-1] == ["1.002", "1620", "1520"]
    assert text.endswith("passed")
    assert "FAILED: 3 divergences" in diagnostics_text(diagnostics, ("3 divergences",))
    unknown = dict.fromkeys(["r_hat", "ess_bulk", "ess_tail", "mcse_mean"], np.nan)
    text = diagnostics_text(pd.DataFrame(diagnostics.assign(**unknown)))
    assert text.splitlines()[2].split()[-4:] == ["-"] * 4
    assert "passed" not in text


def test_a_story_of_a_smooth_force_says_how_large_it_is():
    stories = Story("free run", (), 0.5, 0.25), Story("smooth force", (), 1.5, 0.75, 12.0, 0.3)
    told = stories_text(stories).replace("\n", " ")
    assert "free run: NMSE of a free run 0.5 %, of short ones 0.25 %. smooth force" in told
    assert "of short ones 0.75 %; 12 N on a DOF, with a correlation time of 0.3 s." in told
