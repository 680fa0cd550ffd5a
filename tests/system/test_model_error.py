import csv

import numpy as np
import pytest
from structures import braced

from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, VanDerPol
from pinn_cli.system.model_error import LinearModelError, NoModelError, PerturbedModelError

NOMINAL = {"m": 10.0, "c": 1.0, "k": 15.0, "kappa": 100.0}


def nominal(ndof: int = 6):
    return build_chain(ndof, Duffing(), **NOMINAL)


def ratios(structure) -> dict[str, np.ndarray]:
    return {name: value.numpy() / NOMINAL[name] for name, value in structure.parameters.items()}


def test_none_changes_nothing_and_linear_prescribes_no_nonlinearity():
    structure = nominal()
    assert NoModelError().structures(structure) == (structure, structure)
    true, prescribed = LinearModelError().structures(structure)
    assert true is structure
    assert prescribed.nonlinearity_name == "linear"
    assert prescribed.parameters["k"].tolist() == [15.0] * 6


def test_perturbed_truth_is_five_to_ten_per_cent_off_either_way_and_the_mass_is_right():
    structure = nominal(200)
    true, prescribed = PerturbedModelError(seed=1).structures(structure)
    assert prescribed is structure
    changed = ratios(true)
    assert np.all(changed.pop("m") == 1.0)
    for ratio in changed.values():
        assert np.all((np.abs(ratio - 1.0) >= 0.05 - 1e-12) & (np.abs(ratio - 1.0) <= 0.10 + 1e-12))
        assert 60 < np.sum(ratio > 1.0) < 140


def test_perturbed_draws_do_not_depend_on_the_other_connections_or_parameters():
    short, long = (ratios(PerturbedModelError(seed=3).structures(nominal(ndof))[0]) for ndof in (4, 9))
    np.testing.assert_array_equal(short["k"], long["k"][:4])
    other = build_chain(4, VanDerPol(), m=10.0, c=1.0, k=15.0, mu=0.75)
    np.testing.assert_array_equal(short["k"], PerturbedModelError(seed=3).structures(other)[0].parameters["k"] / 15.0)


def test_authors_draws_give_the_papers_table(shared):
    true, _ = PerturbedModelError(seed=43810, draws="authors").structures(nominal())
    with open(shared / "paper" / "perturbed_parameters.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 18
    for row in rows:
        name, dof = row["parameter"].rsplit("_", 1)
        # The table has two decimals.
        assert true.parameters[name][int(dof) - 1].item() == pytest.approx(float(row["true"]), abs=0.0051)


def test_structures_of_several_laws_have_model_errors_too():
    true, model = PerturbedModelError(seed=3).structures(braced())
    for kind, values in model.parameters.items():
        off = (true.parameters[kind] / values - 1.0).abs()
        assert ((off >= 0.05) & (off <= 0.1)).all() if kind != "m" else (off == 0).all()
    assert set(LinearModelError().structures(braced())[1].parameters) == {"m", "c", "k"}
