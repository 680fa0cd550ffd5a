"""Published values beside ours, with stand-ins for the runs."""

from __future__ import annotations

import pandas as pd

from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.prepare import compose_config
from pinn_cli.paper.cases import TABLES
from pinn_cli.paper.comparison import (
    FITNESS_COLUMNS,
    PARAMETER_COLUMNS,
    compare_fitness,
    compare_parameters,
    compare_wrong_values,
)
from pinn_cli.paper.fitness_sheet import fitness_sheet
from pinn_cli.paper.parameter_sheet import parameter_sheet, wrong_values_sheet
from pinn_cli.paper.rendering import markdown
from pinn_cli.paper.runs import CaseScores

TABLE1, TABLE2, TABLE3, *_ = TABLES
NAN = float("nan")


def _fitness(case: str, variant: str, offset: float) -> CaseScores:
    cells = TABLE2.values.loc[lambda table: table["case"] == case, ["group", "quantity", "fitness_percent"]]
    fitness = cells.assign(range_fitness_percent=cells["fitness_percent"] + offset, fitness_percent=90.0)
    return CaseScores(case, variant, fitness, pd.DataFrame(), 3.0, 5.0)


def _parameters(error_percent: float = 1.0, std_percent: float = 1.0, case: str = "sp_5dof_snr50") -> CaseScores:
    """Each published parameter, estimated too large by so much, among others that are in no table."""
    table = TABLE3.values.loc[lambda table: table["case"] == case, ["parameter", "true"]]
    table = pd.concat([pd.DataFrame({"parameter": ["m_1"], "true": [10.0]}), table], ignore_index=True)
    estimate, std = table["true"] * (1.0 + error_percent / 100.0), table["true"] * std_percent / 100.0
    lower, upper = estimate - 1.645 * std, estimate + 1.645 * std
    found = table.assign(estimate=estimate, error_percent=error_percent, std=std, lower_90=lower, upper_90=upper)
    return CaseScores(case, "fixed", pd.DataFrame(), found, 3.0, 5.0)


def test_table1_agrees_with_the_paper():
    config = RunConfig.read(compose_config(["experiment=paper/sr_6dof_perturbed"]))
    true, _ = config.model_error.structures(config.structure)
    drawn = {parameter.name: parameter.prescribed for parameter in true.every_parameter()}
    parameters = TABLE1.values[["parameter"]].assign(estimate=15.0)
    parameters["true"] = [drawn[name] for name in parameters["parameter"]]
    run = CaseScores("sr_6dof_perturbed", "uncertain", pd.DataFrame(), parameters, 3.0, 5.0)
    table = compare_wrong_values(TABLE1.values, [run])
    assert list(table) == ["parameter", "prescribed", "published", "drawn", "difference", "uncertain"]
    assert len(table) == 18
    assert table["difference"].abs().max() < 0.00501
    assert "18 of 18 agree" in markdown(wrong_values_sheet(TABLE1, table))


def test_table1_without_a_run_has_the_published_values():
    table = compare_wrong_values(TABLE1.values, [])
    assert table["drawn"].isna().all()
    assert "| k | prescribed | 15.00 |" in markdown(wrong_values_sheet(TABLE1, table))


def test_fitness_is_marked_where_it_is_below():
    runs = [_fitness("sr_6dof_snr50", "uncertain", +0.5), _fitness("sr_6dof_snr50", "fixed", -0.5)]
    comparison = compare_fitness(TABLE2.values, runs)
    assert list(comparison) == list(FITNESS_COLUMNS)
    assert len(comparison) == 2 * 10
    assert comparison.groupby("variant")["below_published"].mean().to_dict() == {"uncertain": 0.0, "fixed": 1.0}
    assert comparison["difference"].abs().round(6).eq(0.5).all()
    assert set(comparison["process_seconds"]) == {5.0}
    text = markdown(fitness_sheet(TABLE2, comparison))
    assert text.count("▼") == text.count("▲") == 10 + 1
    assert "|  | ours, uncertain parameters | 99.07 ▲ |" in text
    assert "|  | ours, fixed parameters, printed | 90.00 | 90.00 | 90.00 | - |" in text


def test_equal_at_the_papers_two_decimals_is_not_below():
    comparison = compare_fitness(TABLE2.values, [_fitness("sr_6dof_snr20", "fixed", -0.004)])
    assert not comparison["below_published"].any()


def test_no_runs_are_no_rows():
    assert list(compare_fitness(TABLE2.values, [])) == list(FITNESS_COLUMNS)
    assert list(compare_parameters(TABLE3.values, [])) == list(PARAMETER_COLUMNS)


def test_table3_holds_the_parameters_of_three_noise_levels():
    assert TABLE3.cases == [f"sp_5dof_snr{snr}" for snr in (50, 20, 10)]
    comparison = compare_parameters(TABLE3.values, [_parameters(case=case) for case in TABLE3.cases])
    assert list(comparison) == list(PARAMETER_COLUMNS)
    assert len(comparison) == 3 * 4
    assert set(comparison["parameter"]) == {"k_2", "k_4", "kappa_2", "kappa_4"}


def test_parameters_beside_the_published_ones():
    comparison = compare_parameters(TABLE3.values, [_parameters(0.4, 0.2)])
    assert comparison["larger_error"].tolist() == [False, True, False, True]  # published: 0.615, 0.37, 6.0, 0.326
    assert not comparison["truth_inside"].any()
    text = markdown(parameter_sheet(TABLE3, comparison))
    assert "| k_4 | published | 15 | 14.95 | 0.37 | - |" in text
    assert "|  | ours, fixed parameters |  | 15.060 | 0.40 ▼ | 0.03 |" in text
    assert "90 % intervals that hold the true value: ours, fixed parameters, 0 of 4." in text
    assert "uncertain" not in text


def test_an_interval_that_holds_the_truth():
    comparison = compare_parameters(TABLE3.values, [_parameters(1.0, 1.0)])
    assert comparison["truth_inside"].tolist() == [True] * 4
    assert "ours, fixed parameters, 4 of 4." in markdown(parameter_sheet(TABLE3, comparison))


def test_missing_parameters_and_intervals_are_empty():
    run = _parameters()
    found = run.parameters.query("parameter != 'k_2'").assign(std=NAN, lower_90=NAN, upper_90=NAN)
    comparison = compare_parameters(TABLE3.values, [CaseScores(run.case, "fixed", run.fitness, found, 3.0, 5.0)])
    assert comparison["truth_inside"].isna().all()
    text = markdown(parameter_sheet(TABLE3, comparison))
    rows = [line for line in text.splitlines() if line.startswith("|  | ours")]
    assert rows[0].startswith("|  | ours, fixed parameters |  | - | - | - |")
    assert rows[1].startswith("|  | ours, fixed parameters |  | 15.15 | 1.00 ▼ | - |")
    assert "intervals" not in text
