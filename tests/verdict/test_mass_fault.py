"""A mass that is wrong is found with its factor; a right chain, or one that is wrong otherwise, blames none."""

from __future__ import annotations

import pytest
import torch
from frame_records import measure
from small_problems import small_chain

from pinn_cli.verdict.chain_faults import mass_fault


def with_mass(structure, dof, factor):
    m = structure.parameters["m"].clone()
    m[dof - 1] *= factor
    return structure.with_parameters(m=m)


@pytest.mark.parametrize(("dof", "factor"), [(1, 5.0), (2, 0.5), (3, 2.0)])
def test_one_wrong_mass(frame, frame_record, dof, factor):
    found = mass_fault(with_mass(frame, dof, factor), frame_record)
    assert found is not None
    assert (found.kind, found.suspect) == ("mass", f"m_{dof}")
    assert f"m_{dof} = {10.0:.4g} kg" in found.text or abs(float(found.text.split()[3]) - 10.0) < 0.2


def test_of_a_nonlinear_chain():
    structure = small_chain("duffing", 2)
    found = mass_fault(with_mass(structure, 2, 5.0), measure(structure, strength=2.0))
    assert found is not None
    assert found.suspect == "m_2"


def test_a_right_chain_and_one_with_wrong_springs_blame_no_mass(frame, frame_record):
    assert mass_fault(frame, frame_record) is None
    wrong = frame.with_parameters(k=frame.parameters["k"] * torch.tensor([0.5, 1.6, 0.7], dtype=torch.float64))
    assert mass_fault(wrong, frame_record) is None
