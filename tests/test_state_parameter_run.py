"""Whole runs of state-parameter estimation, small: unknown parameters in the tables, and settings that cannot be."""

import numpy as np
import pandas as pd
import pytest
from calls import SMALL, PinnRun

STATE_PARAMETER = (*SMALL, "scheme=state_parameter", "scheme.unobserved=[2]")


def test_a_run_leaves_what_was_unknown_and_what_was_found(pinn_run: PinnRun) -> None:
    outcome = pinn_run(*STATE_PARAMETER, "scheme.initial={k_2: 5}", "figures=false").done()
    table = outcome.parameters
    assert set(table["scheme"]) == {"state_parameter"}
    assert list(table.index) == [f"{kind}_{dof}" for kind in ("c", "k", "kappa") for dof in (1, 2, 3)]
    assert table.loc[["k_2", "kappa_2"], "true"].tolist() == [15.0, 100.0]
    # The linear chain that comes nearest to the record takes the place of the stiffness that was given.
    assert 0.1 * 15.0 < table.loc["k_2", "start"] < 10.0 * 15.0
    assert table.loc["kappa_2", "start"] == 0.0
    assert table.loc["k_1", "prescribed"] == 15.0
    assert (table["start"].isna() != table["prescribed"].isna()).all()
    assert table.drop(columns=["start", "prescribed"]).notna().all(axis=None)
    assert np.all(table["lower_90"] < table["estimate"])
    assert np.all(table["estimate"] < table["upper_90"])
    for name, share in (("k_2", 0.01), ("kappa_2", 0.3)):
        row = table.loc[name]
        assert abs(row["estimate"] - row["true"]) < 3.0 * row["std"]
        assert 0.0 < row["std"] < share * row["true"]
        assert row["error_percent"] == pytest.approx(100.0 * abs(row["estimate"] / row["true"] - 1.0))
    fitness = pd.read_csv(outcome.directory / "fitness.csv").set_index(["group", "quantity"])["fitness_percent"]
    assert fitness["dof_2", "displacement"] > 98.0
    correlation = pd.read_csv(outcome.directory / "correlation.csv", index_col="parameter")
    assert list(correlation) == list(correlation.index) == list(table.index)
    assert "kappa_2 *" in outcome.out
