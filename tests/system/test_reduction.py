"""Modes and residual vectors of finite-element models."""

import numpy as np
import pytest
from beams import beam, deflection
from refusals import refusal
from scipy.sparse import csc_matrix, diags, eye, kron

from pinn_cli.settings.errors import InputError
from pinn_cli.system.reduction import reduced_model

# Of a clamped beam, (beta L): the roots of cos cosh = -1.
CLAMPED = np.array([1.8751040687, 4.6940911330, 7.8547574382, 10.9955407349])
NONE = np.zeros(0, dtype=np.int64)


def test_a_cantilever_has_the_frequencies_of_the_books():
    reduced = reduced_model(*beam(200), modes=4, static=NONE)
    np.testing.assert_allclose(np.sqrt(reduced.stiffness), CLAMPED**2 * np.sqrt(50.0), rtol=1e-6)


@pytest.mark.parametrize("elements", [20, 400], ids=["dense", "sparse"])
def test_coordinates_are_orthonormal(elements):
    M, K = beam(elements)
    tip, middle = deflection(elements) - 1, deflection(elements // 2) - 1
    reduced = reduced_model(M, K, modes=5, static=np.array([middle, tip]))
    assert (reduced.modes, reduced.vectors.shape[1]) == (5, 7)
    np.testing.assert_allclose(reduced.vectors.T @ (M @ reduced.vectors), np.eye(7), atol=1e-8)
    modal = reduced.vectors.T @ (K @ reduced.vectors) / np.sqrt(np.outer(reduced.stiffness, reduced.stiffness))
    np.testing.assert_allclose(modal, np.eye(7), atol=1e-5)  # rounding of K times a smooth vector


def test_residual_vectors_bend_as_the_whole_model():
    M, K = beam(30)
    places = np.array([deflection(30) - 1, deflection(12) - 1])
    exact = np.linalg.solve(K.toarray(), np.eye(60)[:, places])[places]
    modes, corrected = (reduced_model(M, K, 3, static) for static in (NONE, places))
    found = [r.vectors[places] @ (r.vectors[places] / r.stiffness).T for r in (modes, corrected)]
    np.testing.assert_allclose(found[1], exact, rtol=1e-8)
    assert np.abs(found[0] / exact - 1).max() > 1e-3  # what it would be without


def test_a_residual_vector_that_the_modes_hold_is_left_out():
    M, K = beam(4)
    reduced = reduced_model(M, K, modes=8, static=np.array([6]))
    assert reduced.vectors.shape == (8, 8)


def test_a_body_that_nothing_holds_has_rigid_motions():
    reduced = reduced_model(*beam(50, clamped=False), modes=4, static=np.array([100]))
    assert (reduced.stiffness[:2] == 0).all()
    np.testing.assert_allclose(np.sqrt(reduced.stiffness[2]), 4.7300407449**2 * np.sqrt(50.0), rtol=1e-5)


def test_ten_thousand_dofs_take_seconds():
    side = 100
    line = diags([-np.ones(side - 1), 2 * np.ones(side), -np.ones(side - 1)], [-1, 0, 1])
    K = csc_matrix(1e4 * (kron(line, eye(side)) + kron(eye(side), line)))
    M = csc_matrix(0.1 * eye(side**2))
    reduced = reduced_model(M, K, modes=15, static=np.array([4321]))
    by_line = 2 - 2 * np.cos(np.arange(1, side + 1) * np.pi / (side + 1))
    exact = np.sort(1e5 * np.add.outer(by_line, by_line).ravel())[:15]
    np.testing.assert_allclose(reduced.stiffness[:15], exact, rtol=1e-8)


@pytest.mark.parametrize(
    ("change", "setting"),
    [
        (lambda M, K: (M - 2 * csc_matrix(np.diag(M.diagonal())), K), "system.M"),
        (lambda M, K: (csc_matrix(M - 0.9 * diags(M.diagonal())), K), "system.M"),
        (lambda M, K: (M, K - 1e6 * M), "system.K"),
    ],
    ids=["negative mass", "indefinite mass", "negative stiffness"],
)
@pytest.mark.parametrize("elements", [10, 400], ids=["dense", "sparse"])
def test_what_has_no_modes_is_refused(change, setting, elements):
    assert refusal(reduced_model, *change(*beam(elements)), modes=3, static=NONE).startswith(f"{setting}=")


def test_more_modes_than_dofs_are_refused():
    with pytest.raises(InputError, match="the model has 8 DOFs"):
        reduced_model(*beam(4), modes=9, static=NONE)
