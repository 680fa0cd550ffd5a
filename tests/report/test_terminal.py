"""What a run prints fits 100 columns and says what it leaves out."""

from __future__ import annotations

import pytest

from pinn_cli.report import published
from pinn_cli.report.fitness import fitness_table
from pinn_cli.report.parameters import parameter_table
from pinn_cli.report.terminal import WIDTH, fitness_text, parameters_text
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
    estimates = [ParameterEstimate("k_1", 40e3, 44012.0, 1534.0, float("nan"), float("nan"))]
    text = parameters_text(parameter_table(estimates, None, labels))
    assert text.splitlines()[2].split() == ["k_1", "40000", "44012", "1534", "-"]
    assert parameters_text(parameter_table([], None, labels)) == ""


def _identified(count: int = 2) -> list[ParameterEstimate]:
    """Every second parameter of the named kinds is unknown; of the prescribed ones, the last moved furthest."""
    return [
        ParameterEstimate(f"{kind}_{i}", 10.0, 10.0 + i, 0.1, 9.0 + i, 11.0 + i, 5.0, unknown=i % 2 == 0)
        for kind in ("k", "kappa")
        for i in range(1, 2 * count + 1)
    ]


def _identified_text(estimates, labels, warnings=()):
    table = parameter_table(estimates, None, labels)
    return parameters_text(table, [p.name for p in estimates if p.unknown], warnings)


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
