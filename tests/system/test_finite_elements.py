"""Finite-element models as users give them."""

import logging

import numpy as np
import pytest
from beams import beam, deflection
from refusals import refusal

from pinn_cli.system.finite_elements import build_finite_elements

STOP = {"stop": {"between": ["ground", "tip"], "law": "duffing", "c": 0.0, "k": 0.0, "kappa": 1e5}}
DOFS = {"tip": deflection(10), "middle": deflection(5)}


@pytest.fixture
def folder(tmp_path):
    M, K = beam(10)
    np.savez(tmp_path / "beam.npz", M=M.toarray(), K=K.toarray())
    np.savez(tmp_path / "damped.npz", M=M.toarray(), K=K.toarray(), C=0.3 * M.toarray() + 1e-5 * K.toarray())
    dashpot = np.zeros(M.shape)
    dashpot[DOFS["tip"] - 1, DOFS["tip"] - 1] = 2.0
    np.savez(tmp_path / "dashpot.npz", M=M.toarray(), K=K.toarray(), C=dashpot)
    M, K = beam(10, clamped=False)
    np.savez(tmp_path / "free.npz", M=M.toarray(), K=K.toarray())
    return tmp_path


def built(folder, path="beam.npz", **settings):
    settings = {"dofs": DOFS, "modes": 4, "damping_ratio": 0.01, **settings}
    return build_finite_elements(path=path, base=folder, **settings)


def test_parameters_go_by_modes_and_connections(folder):
    structure = built(folder, connections=STOP)
    assert (structure.ndof, structure.coordinates) == (2, 5)
    names = [parameter.name for parameter in structure.every_parameter()]
    assert {"m_mode_1", "k_mode_4", "c_residual_1", "kappa_stop", "k_stop"} <= set(names)
    assert (structure.dof_name(0), structure.dof_name(1)) == ("tip", "middle")
    p = structure.parameters
    np.testing.assert_allclose(p["c"][:5], 0.02 * p["k"][:5].sqrt())


def test_static_responses_are_those_of_connections_and_forces(folder):
    assert built(folder).coordinates == 4
    assert built(folder, loaded=["middle"]).coordinates == 5
    assert built(folder, loaded=[2], connections=STOP).coordinates == 6
    assert built(folder, loaded=[2], connections=STOP, static_correction=[]).coordinates == 4
    assert built(folder, static_correction=["middle"]).coordinates == 5


def test_elongations_and_forces_are_those_of_the_dofs(folder):
    structure = built(folder, connections=STOP)
    q = np.random.default_rng(1).standard_normal((3, 5))
    u = structure.shapes.of_dofs(q)
    np.testing.assert_allclose(structure.elongation(q)[:, -1], u[:, 0])
    linear = structure.parameters["k"][:5].numpy() * q
    pulled = structure.restoring_force(q, 0.0 * q) - linear
    np.testing.assert_allclose(
        pulled, structure.shapes.onto_coordinates(np.column_stack([1e5 * u[:, 0] ** 3, 0 * u[:, 0]]))
    )


def test_drifts_are_those_of_the_dofs(folder):
    structure = built(folder, connections=STOP, drifts={"bend": ["middle", "tip"], "sway": ["middle", "ground"]})
    q = np.random.default_rng(1).standard_normal((3, 5))
    u = structure.shapes.of_dofs(q)
    expected = np.column_stack([u[:, 0], u[:, 0] - u[:, 1], -u[:, 1]])
    assert structure.drift_names == ("stop", "bend", "sway")
    np.testing.assert_allclose(q @ structure.drifts.T, expected)
    np.testing.assert_allclose(u @ structure.drifts_of_dofs.T, expected)


def test_damping_of_the_modes_is_that_of_c(folder):
    structure = built(folder, "damped.npz", damping_ratio=None)
    p = structure.parameters
    np.testing.assert_allclose(p["c"], 0.3 + 1e-5 * p["k"], rtol=1e-6)


def test_a_damper_couples_the_modes(folder):
    structure = built(folder, "dashpot.npz", damping_ratio=None, modes=20)
    v = np.random.default_rng(2).standard_normal(20)
    of_tip = structure.shapes.of_dofs(v)[0]
    expected = structure.shapes.onto_coordinates(np.array([2.0 * of_tip, 0.0]))
    np.testing.assert_allclose(structure.restoring_force(0.0 * v, v), expected, atol=1e-9 * np.abs(expected).max())


def test_damping_may_be_given_mode_by_mode(folder):
    p = built(folder, damping_ratio=[0.01, 0.05], modes=3).parameters
    np.testing.assert_allclose(p["c"], 2 * np.array([0.01, 0.05, 0.05]) * p["k"].sqrt().numpy())


@pytest.mark.parametrize("ground", ["1::2", "1:20:2", [*range(1, 20, 2)]])
def test_the_ground_moves_the_coordinates_by_their_participation(folder, ground):
    structure = built(folder, ground=ground, modes=20)
    assert structure.shapes.with_ground.tolist() == [1.0, 1.0]
    # All modes together move as the ground does, and so does every DOF.
    np.testing.assert_allclose(structure.shapes.of_dofs(structure.with_ground), 1.0, rtol=1e-8)


def test_a_body_that_nothing_holds_is_told(folder, caplog):
    with caplog.at_level(logging.WARNING):
        built(folder, "free.npz")
    assert "the structure is not held" in caplog.text


@pytest.mark.parametrize(
    ("settings", "setting", "said"),
    [
        ({"path": None}, "system.M", "system.path, a file that holds both"),
        ({"dofs": {}}, "system.dofs", "{tip: 399}"),
        ({"dofs": {"tip": 21}}, "system.dofs.tip", "a DOF from 1 to 20"),
        ({"dofs": {"tip": 0}}, "system.dofs.tip", "a DOF from 1 to 20"),
        ({"dofs": {"tip": 3, "end": 3}}, "system.dofs.end", "tip is DOF 3 as well"),
        ({"modes": 0}, "system.modes", ">= 1"),
        ({"modes": 21}, "system.modes", "at most 20"),
        ({"damping_ratio": -0.1}, "system.damping_ratio", "from 0 to below 1"),
        ({"damping_ratio": [0.1] * 5}, "system.damping_ratio", "at most 4"),
        ({"path": "damped.npz"}, "system.damping_ratio", "null where there is a C"),
        ({"static_correction": ["top"]}, "system.static_correction", "tip, middle"),
        ({"ground": [21]}, "system.ground", "DOFs from 1 to 20"),
        ({"ground": "every"}, "system.ground", "first:last:step"),
        ({"connections": {"s": {**STOP["stop"], "between": ["ground", "top"]}}}, "system.connections.s.between", "tip"),
        ({"drifts": {"d": ["tip", "top"]}}, "system.drifts.d", "ground or one of tip, middle"),
        ({"drifts": {"d": ["tip", "tip"]}}, "system.drifts.d", "two different ends"),
        ({"drifts": [["tip", "middle"]]}, "system.drifts", "{roof: [ground, x3]}"),
        ({"drifts": {"stop": ["tip", "middle"]}, "connections": STOP}, "system.drifts", "another name"),
        ({"connections": {"mode_1": STOP["stop"]}}, "system.connections", "another name"),
    ],
)
def test_bad_input_is_refused_in_one_line(folder, settings, setting, said):
    told = refusal(built, folder, **settings)
    assert told.startswith(f"{setting}=")
    assert said in told
