import pytest
import torch

from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Linear, PowerDamping, VanDerPol

LEGAL = {"m": 10.0, "c": 1.0, "k": 15.0, "kappa": 100.0}


def test_numbers_and_lists_become_float64_of_every_connection():
    structure = build_chain(3, Duffing(), **{**LEGAL, "k": [15, 14, 16.5], "m": 10})
    assert structure.ndof == 3
    assert {value.dtype for value in structure.parameters.values()} == {torch.float64}
    assert structure.parameters["k"].tolist() == [15.0, 14.0, 16.5]
    assert structure.parameters["m"].tolist() == [10.0] * 3


def test_what_is_missing_is_named():
    with pytest.raises(InputError, match=r"^system\.mu=nothing"):
        build_chain(3, VanDerPol(), m=1.0, c=1.0, k=1.0)
    with pytest.raises(InputError, match=r"list of 3 numbers \(system\.ndof=3\); it has 2"):
        build_chain(3, Linear(), m=1.0, c=1.0, k=[1.0, 2.0])


def test_signs_that_make_sense_pass():
    assert build_chain(2, Duffing(), **{**LEGAL, "kappa": -5.0}).parameters["kappa"].tolist() == [-5.0, -5.0]
    assert build_chain(2, VanDerPol(), m=1.0, c=0.0, k=0.0, mu=-0.1).parameters["mu"].tolist() == [-0.1, -0.1]
    with pytest.raises(InputError, match=r"^system\.mu="):
        build_chain(2, PowerDamping(), m=1.0, c=0.0, k=0.0, mu=-0.1)
