"""Damping of a structure as a whole: a ratio for each mode, or Rayleigh's."""

import numpy as np
import pytest
import torch
from scipy.linalg import eigh

from pinn_cli.model.file import structure_content, structure_of
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain, build_partial_chain
from pinn_cli.system.connection import Duffing, Linear
from pinn_cli.system.finite_elements import build_finite_elements
from pinn_cli.system.modes import NaturalModes
from pinn_cli.system.topology import build_structure

K, MASS = [1.5e6, 1.4e6, 1.2e6], 2000.0
BRACED = {
    "s1": {"between": ["ground", "x1"], "law": "linear", "k": 2e6},
    "s2": {"between": ["x1", "x2"], "law": "duffing", "c": 300.0, "k": 1.5e6, "kappa": 1e9},
    "brace": {"weights": {"x2": 0.8}, "law": "linear", "k": 6e5},
}


def chain(damping):
    return build_chain(3, Linear(), damping, m=MASS, k=K)


def braced(damping):
    return build_structure(["x1", "x2"], {"x1": 3000.0, "x2": 2500.0}, BRACED, damping=damping)


def matrices(structure, velocity):
    """M, K and the damping forces at rest, from the structure's own equation."""
    n = structure.coordinates
    m, none = structure.parameters["m"].numpy(), np.zeros(n)
    stiffness = np.stack([structure.restoring_force(1e-9 * row, none) * 1e9 for row in np.eye(n)], axis=1)
    return np.diag(m), stiffness, structure.restoring_force(none, velocity)


@pytest.mark.parametrize(("build", "ratios"), [(chain, [0.02, 0.01, 0.03]), (chain, 0.02), (braced, [0.02, 0.05])])
def test_ratios_are_those_of_the_modes(build, ratios):
    structure = build({"ratio": ratios})
    velocity = np.random.default_rng(0).normal(size=structure.coordinates)
    M, stiffness, felt = matrices(structure, velocity)
    squares, shapes = eigh(stiffness, M)
    expected = M @ shapes @ np.diag(2.0 * np.broadcast_to(ratios, squares.shape) * np.sqrt(squares)) @ shapes.T @ M
    if build is braced:
        expected += 300.0 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    np.testing.assert_allclose(felt, expected @ velocity, rtol=1e-6)


@pytest.mark.parametrize("build", [chain, braced])
def test_rayleigh_damping_is_proportional_to_mass_and_stiffness(build):
    structure = build({"rayleigh": [0.3, 1e-3]})
    velocity = np.random.default_rng(0).normal(size=structure.coordinates)
    M, stiffness, felt = matrices(structure, velocity)
    felt_alone = felt - (matrices(build({"ratio": 0.0}), velocity)[2])
    np.testing.assert_allclose(felt_alone, (0.3 * M + 1e-3 * stiffness) @ velocity, rtol=1e-6)


def test_they_belong_to_the_modes_of_the_present_structure():
    structure = chain({"ratio": [0.02, 0.01]})
    stiffer = structure.with_values({structure.parameter("k", 0): 3e6})
    np.testing.assert_allclose(NaturalModes.of(stiffer).damping_ratios, [0.02, 0.01, 0.01], rtol=1e-9)
    assert structure.damping_change(stiffer) > 0.1
    assert structure.damping_change(structure.with_values({})) == 0.0


def test_their_names_and_where_they_are_unknown():
    assert [p.name for p in chain({"ratio": 0.02}).every_parameter()][-1] == "zeta"
    assert [p.name for p in chain({"ratio": [0.02, 0.01]}).every_parameter()][-2:] == ["zeta_1", "zeta_2"]
    partial = build_partial_chain(3, Linear(), {"rayleigh": [None, 1e-3]}, m=MASS)
    a_0, a_1 = list(partial.every_parameter())[-2:]
    assert (a_0.name, a_1.name) == ("a_0", "a_1")
    assert np.isnan(a_0.prescribed)
    assert a_1.prescribed == 1e-3
    assert (a_0.owner, a_0.unit, partial.labels.setting(a_0)) == ("the structure", "1/s", "system.damping")


@pytest.mark.parametrize("damping", [{"ratio": [0.02, 0.01]}, {"rayleigh": [0.3, 1e-3]}])
def test_a_run_keeps_them(damping):
    structure = braced(damping)
    again = structure_of(*structure_content(structure))
    u = torch.tensor([0.01, -0.02], dtype=torch.float64)
    torch.testing.assert_close(again.restoring_force(u, u), structure.restoring_force(u, u))
    assert again.present().damping_change(structure) < 1e-12


def test_springs_that_stiffen_count_at_rest():
    cubic = build_chain(3, Duffing(), {"ratio": 0.02}, m=MASS, k=K, kappa=1e10)
    assert cubic.damping_change(chain({"ratio": 0.02})) == 0.0


@pytest.mark.parametrize(
    "damping",
    [0.02, {"ratio": 1.5}, {"ratio": [0.1] * 4}, {"ratios": 0.1}, {"rayleigh": [1.0]}, {"rayleigh": [-1.0, 0.0]}],
)
def test_other_damping_is_refused(damping):
    with pytest.raises(InputError, match="damping"):
        chain(damping)


def test_ratios_of_a_finite_element_model_are_those_with_its_factors(tmp_path):
    stiffness = np.diag([2.9e6, 2.6e6, 1.2e6]) - np.diag([1.4e6, 1.2e6], 1) - np.diag([1.4e6, 1.2e6], -1)
    base = np.diag([1.5e6, 0.0, 0.0])
    np.savez(tmp_path / "whole.npz", M=MASS * np.eye(3), K=stiffness)
    np.savez(tmp_path / "base.npz", base=base)
    structure = build_finite_elements(
        {"x1": 1, "x2": 2, "x3": 3},
        str(tmp_path / "whole.npz"),
        modes=3,
        factors={"base": {"file": str(tmp_path / "base.npz"), "value": 0.7}},
        damping={"ratio": [0.02, 0.01, 0.03]},
    )
    modes = NaturalModes.of(structure)
    expected = eigh(stiffness - 0.3 * base, MASS * np.eye(3), eigvals_only=True)
    np.testing.assert_allclose(modes.frequencies, np.sqrt(expected) / (2.0 * np.pi), rtol=1e-6)
    np.testing.assert_allclose(modes.damping_ratios, [0.02, 0.01, 0.03], rtol=1e-6)
