"""The published values are shipped and load."""

from __future__ import annotations

from pinn_cli.record.response import QUANTITIES
from pinn_cli.report import published


def test_fitness():
    table = published.fitness()
    assert list(table) == [
        "table", "case", "ndof", "nonlinearity", "model_error", "snr_db", "group", "quantity", "fitness_percent",
    ]  # fmt: skip
    assert set(table["quantity"]) == set(QUANTITIES)
    assert set(table["model_error"]) == {"none", "linear", "perturbed"}
    assert table.groupby("table")["case"].nunique().to_dict() == {"sr-summary": 6, "spe-summary": 6}
    assert table["fitness_percent"].between(90.0, 100.0).all()


def test_parameters():
    assert len(published.parameters()) == 34
    perturbed = published.perturbed_parameters()
    assert len(perturbed) == 18
    assert (perturbed["true"] / perturbed["prescribed"] - 1.0).abs().between(0.04, 0.11).all()
