"""Means and spreads over seeds, and their figure."""

import numpy as np
import pandas as pd
import pytest

from pinn_cli.sweep.summary import is_seed, numeric_settings, summarise, sweep_figure


def fitness(**settings: list[object]) -> pd.DataFrame:
    """A row per combination of settings and quantity; its fitness grows with the seed, and one job has failed."""
    rows = pd.DataFrame({"estimator": ["pinn"], "group": ["all"], "status": ["finished"]})
    for name, values in {**settings, "quantity": ["displacement", "force"]}.items():
        rows = rows.merge(pd.DataFrame({name.replace("__", "."): values}), how="cross")
    rows["fitness_percent"] = 90.0 + rows["seed"].astype(float)
    rows["range_fitness_percent"] = 99.0
    failed = {name.replace("__", "."): values[0] for name, values in settings.items()} | {"status": "failed"}
    return pd.concat([rows, pd.DataFrame([failed])], ignore_index=True)


def test_mean_spread_and_number_of_seeds() -> None:
    table = summarise(fitness(noise__snr_db=["50", "20"], seed=["0", "1", "5"]), ["noise.snr_db", "seed"])
    assert list(table.columns[:4]) == ["noise.snr_db", "estimator", "group", "quantity"]
    assert len(table) == 4
    np.testing.assert_allclose(table["fitness_percent_mean"], 92.0)
    np.testing.assert_allclose(table["fitness_percent_std"], np.sqrt(7.0))
    np.testing.assert_allclose(table["range_fitness_percent_std"], 0.0)
    assert table["seeds"].tolist() == [3] * 4
    assert table.groupby("noise.snr_db", sort=False)["failed"].first().to_dict() == {"50": 1, "20": 0}


def test_one_seed_has_no_spread_and_no_truth_no_row() -> None:
    rows = fitness(a=["x"], seed=["0"])
    rows.loc[rows["quantity"] == "force", "fitness_percent"] = np.nan
    table = summarise(rows, ["a", "seed"])
    assert table["quantity"].tolist() == ["displacement"]
    assert table["fitness_percent_std"].isna().all()


def test_nothing_but_seeds_and_nothing_but_failures() -> None:
    table = summarise(fitness(seed=["0", "1"]), ["seed"])
    assert table["seeds"].tolist() == [2, 2]
    assert table["failed"].tolist() == [1, 1]
    table = summarise(fitness(a=["x", "y"], seed=["0"]).assign(status="failed"), ["a", "seed"])
    assert set(table["a"]) <= {"x", "y"}


@pytest.mark.parametrize("name", ["seed", "excitation.seed", "noise.seeds", "model_error.force_seed"])
def test_seeds(name: str) -> None:
    assert is_seed(name)
    assert not is_seed(name + "ing")


def test_a_figure_has_a_column_per_numeric_setting_and_lines_for_the_others() -> None:
    settings = {"a": ["1", "10", "100"], "b": ["2.5", "3"], "scheme": ["x", "y"]}
    table = summarise(fitness(**settings, seed=["0", "1"]), [*settings, "seed"])
    assert numeric_settings(table, [*settings]) == ["a", "b"]
    figure = sweep_figure(table, [*settings])
    axes = figure.axes
    assert [axis.get_xlabel() for axis in axes if axis.get_xlabel()] == ["a", "b"]
    assert axes[0].get_xscale() == "log"
    assert axes[1].get_xscale() == "linear"
    assert len(axes[0].containers) == 4  # b times scheme
    assert len(axes[1].containers) == 6
    np.testing.assert_allclose(axes[0].containers[0].lines[0].get_ydata(), 9.5)
    low, high = axes[0].get_ylim()
    assert [tick for tick in axes[0].get_yticks() if low <= tick <= high]


def test_many_lines_are_told_by_their_median() -> None:
    table = summarise(fitness(a=["1", "2"], b=[str(n) for n in range(12)], seed=["0"]), ["a", "b", "seed"])
    figure = sweep_figure(table, ["a", "b"])
    assert figure.axes[0].get_legend_handles_labels()[1] == ["median of 12 other settings"]


def test_without_a_numeric_setting_there_is_no_figure() -> None:
    table = summarise(fitness(scheme=["x", "y"], seed=["0"]), ["scheme", "seed"])
    assert sweep_figure(table, ["scheme"]) is None
