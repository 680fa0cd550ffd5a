"""Factors of the stiffness of parts of a finite-element model."""

import logging

import numpy as np
import pytest
import torch
from beams import beam, beam_part, deflection
from calls import refusal
from scipy.io import mmwrite
from scipy.linalg import eigh

from pinn_cli.scheme.unknowns import all_names
from pinn_cli.system.basis import is_exact_at, reduced_at
from pinn_cli.system.finite_elements import build_finite_elements
from pinn_cli.system.modes import modes_of

ELEMENTS = 30
PARTS = {"base": range(10), "middle": range(10, 20), "top": range(20, 30)}
DOFS = {"tip": deflection(30), "a": deflection(12)}
STOP = {"stop": {"between": ["ground", "tip"], "law": "duffing", "c": 0.0, "k": 50.0, "kappa": 1e5}}


@pytest.fixture
def folder(tmp_path):
    M, K = beam(ELEMENTS)
    np.savez(tmp_path / "beam.npz", M=M.toarray(), K=K.toarray(), every=K.toarray())
    for name, own in PARTS.items():
        mmwrite(str(tmp_path / f"{name}.mtx"), beam_part(ELEMENTS, own))
    mmwrite(str(tmp_path / "short.mtx"), beam_part(5, range(5)))
    mmwrite(str(tmp_path / "nothing.mtx"), 0.0 * K)
    mmwrite(str(tmp_path / "negative.mtx"), -K)
    np.savez(tmp_path / "lopsided.npz", K=np.triu(K.toarray()))
    return tmp_path


def built(folder, factors=None, **settings):
    factors = {name: f"{name}.mtx" for name in PARTS} if factors is None else factors
    settings = {"dofs": DOFS, "modes": 6, "damping_ratio": 0.01, "loaded": ["tip"], **settings}
    return build_finite_elements(path="beam.npz", base=folder, factors=factors, **settings)


def full_frequencies(factors, count):
    M, _ = beam(ELEMENTS)
    K = sum(f * beam_part(ELEMENTS, own) for f, own in zip(factors, PARTS.values(), strict=True))
    return np.sqrt(eigh(K.toarray(), M.toarray(), eigvals_only=True)[:count]) / (2 * np.pi)


def with_factors(structure, factors):
    return structure.with_parameters(factor=torch.tensor(factors, dtype=torch.float64))


@pytest.mark.parametrize("factors", [[1.0, 1.0, 1.0], [0.85, 1.0, 1.1], [1.3, 0.7, 1.2]])
def test_frequencies_are_those_of_the_whole_model(folder, factors):
    found = modes_of(with_factors(built(folder), factors)).natural_frequencies[:6]
    expected = full_frequencies(factors, 6)
    near = max(abs(factor - 1.0) for factor in factors) < 0.2
    np.testing.assert_allclose(found, expected, rtol=5e-5 if near else 4e-4)


def whole_response(factors, rates):
    """(rates, DOFs), accelerations per newton on the first of DOFS, of the whole model with a loss factor."""
    M, _ = beam(ELEMENTS)
    K = sum(f * beam_part(ELEMENTS, own) for f, own in zip(factors, PARTS.values(), strict=True))
    return receptance(M.toarray(), K.toarray(), np.eye(len(M.toarray()))[np.array(list(DOFS.values())) - 1], rates)


def receptance(M, K, places, rates):
    """(rates, DOFs), of the DOFs that rows of ``places`` (DOFs, n) pick, a force on the first of them."""
    return np.array([-(w**2) * places @ np.linalg.solve((1 + 0.04j) * K - w**2 * M, places[0]) for w in rates])


@pytest.mark.parametrize("factors", [[0.7, 1.3, 0.75], [1.3, 0.7, 1.2]])
def test_coordinates_at_factors_move_as_the_whole_model(folder, factors):
    """Also at sensors that no force is on; coordinates of the model as prescribed are tens of times as far off."""
    first = with_factors(built(folder, dofs={**DOFS, "b": deflection(19)}), factors)
    again = reduced_at(first)
    assert again.coordinates == first.coordinates
    np.testing.assert_allclose(modes_of(again).natural_frequencies[:6], full_frequencies(factors, 6), rtol=1e-8)
    rates = 2.0 * np.pi * np.linspace(0.1, 1.0, 60) * full_frequencies(factors, 5)[-1]
    expected = whole_response(factors, rates)
    off = []
    for structure in (first, again):
        n = structure.coordinates
        found = receptance(np.eye(n), modes_of(structure).K, structure.shapes.matrix, rates)[:, : len(DOFS)]
        off.append(np.linalg.norm(found - expected, axis=0) / np.linalg.norm(expected, axis=0))
    assert off[1].max() < 2e-4, off
    assert (off[1] < 0.1 * off[0]).all(), off


def test_coordinates_at_factors_keep_what_was_said(folder):
    first = with_factors(built(folder, connections=STOP), [0.8, 1.1, 1.2])
    softer = first.with_parameters(k=first.parameters["k"] * 0.9)
    again = reduced_at(softer)
    for kind in ("factor", "kappa"):
        assert torch.equal(again.parameters[kind], first.parameters[kind])
    own = first.groups[0].incidence.shape[0]
    assert torch.equal(again.parameters["k"][own:], softer.parameters["k"][own:])
    made = again.reduction.structure.parameters["k"][:own]
    torch.testing.assert_close(again.parameters["k"][:own], 0.9 * made)
    assert is_exact_at(again, np.array([0.8, 1.1, 1.2]), 1e-9)
    assert not is_exact_at(again, np.array([0.8, 1.1, 1.3]), 1e-3)
    turn = first.reduction.onto(again.reduction)
    shape = np.linalg.lstsq(first.shapes.matrix, [1.0, 0.4], rcond=None)[0]  # of low modes, which both hold
    low = np.where(np.arange(len(shape)) < 3, shape, 0.0)
    np.testing.assert_allclose(again.shapes.matrix @ turn @ low, first.shapes.matrix @ low, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("modes", [2 * ELEMENTS - 1, 2 * ELEMENTS])
def test_all_modes_may_be_kept(folder, modes):
    structure = built(folder, modes=modes)
    assert structure.coordinates == 2 * ELEMENTS
    found = modes_of(with_factors(structure, [0.7, 1.3, 0.7])).natural_frequencies
    np.testing.assert_allclose(found[:50], full_frequencies([0.7, 1.3, 0.7], 50), rtol=1e-6)


def test_static_deflections_are_those_of_the_whole_model(folder):
    structure = with_factors(built(folder), [0.8, 1.0, 1.2])
    push = structure.shapes.matrix[0]
    found = structure.shapes.matrix @ np.linalg.solve(modes_of(structure).K, push)
    K = sum(f * beam_part(ELEMENTS, own) for f, own in zip([0.8, 1.0, 1.2], PARTS.values(), strict=True))
    places = np.array(list(DOFS.values())) - 1
    expected = np.linalg.solve(K.toarray(), np.eye(K.shape[0])[:, places[0]])[places]
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_a_factor_is_one_parameter_of_many_connections(folder):
    structure = built(folder, connections=STOP)
    names = all_names(structure)
    assert [name for name in names if name.startswith("factor")] == ["factor_base", "factor_middle", "factor_top"]
    assert names["factor_top"].owner == "part top"
    assert structure.labels.setting(names["factor_top"]) == "system.factors.top"
    assert [structure.labels.connection(i) for i in structure.added] == ["stop"]
    assert len(structure.ends(names["factor_top"])) == structure.coordinates


def test_derivatives_by_factors_are_those_of_the_force(folder):
    structure = with_factors(built(folder, connections=STOP), [0.9, 1.0, 1.1])
    u, v = (torch.as_tensor(np.random.default_rng(s).standard_normal((3, structure.coordinates))) for s in (2, 3))
    slope = structure.linearise(u, v, structure.parameters)
    connections, which = structure.carriers["factor"]
    pull = torch.as_tensor(structure.incidence.matrix[connections].toarray())
    for j in range(3):
        found = slope.by_parameter["factor"][:, which == j] @ pull[which == j]
        more, less = ([*structure.parameters["factor"].tolist()] for _ in range(2))
        more[j], less[j] = more[j] + 1e-3, less[j] - 1e-3
        forces = [with_factors(structure, f).restoring_force(u, v) for f in (more, less)]
        torch.testing.assert_close(found, (forces[0] - forces[1]) / 2e-3, rtol=1e-6, atol=1e-4)


def test_a_forgotten_nonlinearity_leaves_the_parts(folder):
    structure = with_factors(built(folder, connections=STOP), [0.9, 1.0, 1.1])
    u = np.random.default_rng(5).standard_normal(structure.coordinates) * 1e-6  # too little for the cubic spring
    linear = structure.linearised()
    assert "kappa" not in linear.parameters
    np.testing.assert_allclose(linear.restoring_force(u, 0 * u), structure.restoring_force(u, 0 * u), rtol=1e-6)


def test_a_value_is_the_factor_and_a_file_of_several_holds_parts(folder):
    structure = built(folder, {"every": {"value": 0.8}})
    assert structure.parameters["factor"].tolist() == [0.8]
    frequencies = modes_of(structure).natural_frequencies[:3]
    np.testing.assert_allclose(frequencies, np.sqrt(0.8) * full_frequencies([1.0] * 3, 3), rtol=1e-6)


@pytest.mark.parametrize(
    ("factors", "setting", "said"),
    [
        ("base.mtx", "system.factors", "{K_2: K2.mtx}"),
        ({"base": "absent.mtx"}, "system.factors.base", "there is none at"),
        ({"base": "short.mtx"}, "system.factors.base", "as large as K, 60 x 60"),
        ({"base": "lopsided.npz"}, "system.factors.base", "a symmetric matrix"),
        ({"base": "nothing.mtx"}, "system.factors.base", "a matrix of zeros"),
        ({"base": "negative.mtx"}, "system.factors.base", "positive semidefinite"),
        ({"base": "base.mtx", "twice": "base.mtx"}, "system.factors", "is a part there twice"),
        ({"base": {"file": "base.mtx", "value": 0}}, "system.factors.base.value", "a number > 0"),
        ({"base": {"file": "base.mtx", "factor": 2}}, "system.factors.base.factor", "file and value"),
        ({"the base": "base.mtx"}, "system.factors", "a name"),
        ({"stop": "base.mtx"}, "system.factors", "another name"),
    ],
)
def test_bad_input_is_refused_in_one_line(folder, factors, setting, said):
    told = refusal(built, folder, factors, connections=STOP)
    assert told.startswith(f"{setting}=")
    assert said in told


def test_stiff_parts_hold_no_less_than_modes(folder, caplog):
    """The shapes of parts are a million times as stiff as the lowest mode, which its own spring holds all the same."""
    with caplog.at_level(logging.WARNING):
        built(folder, modes=8)
    assert not caplog.text
