"""What a run prints fits 100 columns and says what it leaves out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_estimates import parameter_estimate

from pinn_cli.record.response import Response
from pinn_cli.report import published
from pinn_cli.report.fitness import fitness_table
from pinn_cli.report.free_run import FreeRun, free_run_table
from pinn_cli.report.parameters import parameter_table
from pinn_cli.report.residuals import residual_table
from pinn_cli.report.terminal.columns import WIDTH
from pinn_cli.report.terminal.fitness import fitness_text, free_run_line
from pinn_cli.report.terminal.parameters import parameters_text
from pinn_cli.report.terminal.run import sensors_text
from pinn_cli.training.estimate import ParameterEstimate


def _tables(case, name="small"):
    labels = case.labels | {"case": name}
    fitness = fitness_table(case.estimate.response, case.truth.response, case.record.observed, labels)
    return fitness, parameter_table(case.estimate.parameters, case.truth.parameters, labels)


@pytest.mark.parametrize("ndof", [1, 6, 20])
def test_width(ndof, make_case):
    case = make_case(ndof=ndof, observed=1)
    fitness, parameters = _tables(case, "sr_6dof_snr50")
    text = fitness_text(fitness, case.record.observed, published.fitness()) + "\n" + parameters_text(parameters)
    assert max(map(len, text.splitlines())) <= WIDTH


def test_rows_of_a_short_chain(make_case):
    case = make_case(ndof=3, observed=2)
    fitness, _ = _tables(case)
    lines = fitness_text(fitness, case.record.observed).splitlines()
    names = [line.split("  ")[0].rstrip() for line in lines[3:]]
    assert names[:-1] == ["all", "first", "last", "observed", "unobserved", "dof_1", "dof_2", "dof_3 *"]
    assert lines[-1] == "* no response sensor on this DOF"
    assert lines[-2].split()[2:6][3] == "-"  # no force on the last DOF: an empty cell


def test_a_long_chain_points_to_the_file(make_case):
    fitness, parameters = _tables(make_case(ndof=20, observed=7))
    text = fitness_text(fitness)
    assert "dof_7" not in text
    assert "dof_1 to dof_20: fitness.csv" in text
    assert "the 24 of 60 that moved furthest" in parameters_text(parameters)


def test_published_rows_of_this_case_only(make_case):
    fitness, _ = _tables(make_case(), "sr_6dof_snr50")
    text = fitness_text(fitness, published=published.fitness())
    assert text.count("published") == 3
    assert "98.57" in text
    fitness, _ = _tables(make_case())
    assert "published" not in fitness_text(fitness, published=published.fitness())


def test_parameters(make_case):
    labels = make_case().labels
    estimates = [parameter_estimate("k_1", 40e3, 44012.0, 1534.0, float("nan"), float("nan"))]
    text = parameters_text(parameter_table(estimates, None, labels))
    assert text.splitlines()[2].split() == ["k_1", "40000", "44012", "1534", "-"]
    assert parameters_text(parameter_table([], None, labels)) == ""


def _identified(count: int = 2) -> list[ParameterEstimate]:
    """Every second parameter of the named kinds is unknown; of the prescribed ones, the last moved furthest."""
    return [
        parameter_estimate(f"{kind}_{i}", 10.0, 10.0 + i, 0.1, 9.0 + i, 11.0 + i, 5.0, unknown=i % 2 == 0)
        for kind in ("k", "kappa")
        for i in range(1, 2 * count + 1)
    ]


def _identified_text(estimates, labels, warnings=()):
    table = parameter_table(estimates, None, labels)
    return parameters_text(table, warnings)


def test_unknown_parameters_come_first_and_are_marked(make_case):
    lines = _identified_text(_identified(), make_case().labels).splitlines()
    names = [line.split("  ")[0] for line in lines]
    assert names[2:6] == ["k_2 *", "k_4 *", "kappa_2 *", "kappa_4 *"]
    assert lines[0].split()[:3] == ["parameter", "start", "estimate"]
    assert set(lines[6]) == {"-"}
    assert lines[7].split()[:3] == ["parameter", "prescribed", "estimate"]
    assert names[9:13] == ["k_1", "k_3", "kappa_1", "kappa_3"]
    assert lines[13].startswith("* unknown:")
    assert lines[14:] == ["every unknown parameter is well determined"]


def test_all_unknown_parameters_are_shown_and_a_handful_of_the_prescribed(make_case):
    lines = _identified_text(_identified(count=20), make_case().labels).splitlines()
    assert sum(" * " in line for line in lines) == 40
    assert len(lines) == 2 + 40 + 3 + 8 + 3
    assert lines[45].startswith("k_33 ")
    assert lines[53].startswith("the 8 of 40 that moved furthest")


def test_only_unknown_parameters_need_no_rule_between(make_case):
    lines = _identified_text([p for p in _identified() if p.unknown], make_case().labels).splitlines()
    assert sum(set(line) == {"-"} for line in lines) == 1
    assert "prescribed" not in lines[0]


def test_warnings_are_marked_counted_and_fit(make_case):
    warnings = [f"k_{i} " + "can hardly be told from the others " * 3 for i in range(15)]
    text = _identified_text(_identified(), make_case().labels, warnings)
    assert text.count("! ") == 12 + 1
    assert text.splitlines()[-1] == "! and 3 more: identifiability.csv"
    assert max(map(len, text.splitlines())) <= WIDTH


def _held_out(case, quantity, *dofs):
    """A truth that is known of one quantity on some DOFs only."""
    unknown = Response.unknown(case.record.time, case.record.ndof)
    known = np.isin(np.arange(1, case.record.ndof + 1), dofs)
    return replace(unknown, **{quantity: np.where(known, getattr(case.truth.response, quantity), np.nan)})


def test_without_a_truth_there_is_no_table_of_fitness(make_case):
    case = make_case(ndof=3)
    unknown = Response.unknown(case.record.time, 3)
    assert fitness_text(fitness_table(case.estimate.response, unknown, case.record.observed, case.labels)) == ""


def test_of_held_out_sensors_only_what_can_be_scored_is_printed(make_case):
    case = make_case(ndof=3, observed=2)
    table = fitness_table(case.estimate.response, _held_out(case, "acceleration", 3), case.record.observed, case.labels)
    lines = fitness_text(table, case.record.observed).splitlines()
    assert lines[1].split() == ["DOFs", "accel.", "accel."]
    assert [line.split()[0] for line in lines[3:]] == ["all", "last", "unobserved", "dof_3", "*"]
    assert " - " not in "".join(lines)


def test_sensors_have_a_line_each_with_units_and_no_dashes(make_case):
    case = make_case(ndof=3, observed=2)
    table = residual_table(case.estimate, case.record, None, case.labels)
    lines = sensors_text(table).splitlines()
    assert lines[0].split("  ")[0] == "sensor"
    assert [line.split()[:3] for line in lines[2:5]] == [
        ["acceleration", "1", "m/s^2"],
        ["acceleration", "2", "m/s^2"],
        ["force", "1", "N"],
    ]
    assert "noise" not in lines[0]  # none was found, and there is no free run
    assert "free run" not in lines[0]
    assert all(cell != "-" for line in lines[2:5] for cell in line.split())


def test_sensors_beside_a_baseline_fit_and_of_many_the_worst_are_shown(make_case):
    case = make_case(ndof=40, observed=40)
    estimate = replace(case.estimate, summary={"sigma_acceleration": [1e-7] * 40, "sigma_force": [1e-7] * 40})
    table = residual_table(estimate, case.record, case.truth.response, case.labels)
    text = sensors_text(table, ("kalman_smoother", table))
    assert max(map(len, text.splitlines())) <= WIDTH
    assert "kalman_smoother (%)" in text
    assert "the 24 of 41 sensors with the largest NMSE" in text


def test_a_baselines_parameters_stand_beside_ours_where_there_is_no_truth(make_case):
    estimates, labels = _identified(), make_case().labels
    theirs = [replace(p, estimate=77.0, std=0.5) for p in estimates]
    table, other = (parameter_table(given, None, labels) for given in (estimates, theirs))
    text = parameters_text(table, baseline=("kalman_smoother", other))
    lines = text.splitlines()
    assert lines[0].split()[-2:] == ["kalman_smoother", "std"]
    assert lines[2].split()[-2:] == ["77.000", "0.50"]
    assert max(map(len, lines)) <= WIDTH
    assert " - " not in text
    known = parameter_table(estimates, {"k": np.ones(4), "kappa": np.ones(4)}, labels)
    assert "kalman_smoother" not in parameters_text(known, baseline=("kalman_smoother", other))


def test_a_free_run_in_a_sentence(make_case):
    case = make_case(ndof=2)
    run = FreeRun(case.estimate.response)
    unknown = Response.unknown(case.record.time, 2)
    table = free_run_table(run, case.estimate, case.record, unknown, case.labels)
    assert free_run_line(run, table).startswith("the free run's displacements agree with the estimate's to 100.00 %")
    assert free_run_line(FreeRun(None, "no force"), table) == "no force"
