"""Simulated finite-element models against their own matrices, whole, in scipy's hands."""

import numpy as np
import pytest
from beams import beam, deflection
from refusals import refusal
from scipy.integrate import solve_ivp

from pinn_cli.record.simulation import simulate
from pinn_cli.system.finite_elements import build_finite_elements

ELEMENTS, KAPPA = 3, 4e3
DOFS = {"tip": deflection(3), "middle": deflection(2), "slope": 6}
TIME = np.linspace(0.0, 0.1, 51)
STOP = {"stop": {"between": ["ground", "tip"], "law": "duffing", "c": 0.0, "k": 0.0, "kappa": KAPPA}}


def push(time):
    """On the middle, N."""
    return 20.0 * np.sin(40.0 * time) * np.sin(7.0 * time + 1.0)


def shaking(time):
    return 30.0 * np.sin(35.0 * time) * np.sin(6.0 * time)


def whole_model(M, K, C, kappa=0.0, push=None, shaking=None):
    """(N, 3) each: displacement, velocity and absolute acceleration of the named DOFs, every DOF integrated."""
    size, places = M.shape[0], [dof - 1 for dof in DOFS.values()]
    moved = np.arange(size) % 2 == 0
    inverse = np.linalg.inv(M)

    def acceleration(t, u, v):
        force = -K @ u - C @ v
        force[places[0]] -= kappa * u[places[0]] ** 3
        force[places[1]] += 0.0 if push is None else push(t)
        return inverse @ force - (0.0 if shaking is None else moved * shaking(t))

    solution = solve_ivp(
        lambda t, y: np.concatenate((y[size:], acceleration(t, y[:size], y[size:]))),
        (TIME[0], TIME[-1]), np.zeros(2 * size), "DOP853", TIME, rtol=1e-11, atol=1e-13, max_step=0.002,
    )  # fmt: skip
    u, v = solution.y[:size].T, solution.y[size:].T
    a = np.array([acceleration(*state) for state in zip(TIME, u, v, strict=True)])
    a = a if shaking is None else a + moved * shaking(TIME)[:, None]
    return u[:, places], v[:, places], a[:, places]


@pytest.fixture
def model(tmp_path):
    M, K = (matrix.toarray() for matrix in beam(ELEMENTS))
    C = 0.8 * M + 2e-4 * K
    C[4, 4] += 0.5  # a dashpot, which couples the modes
    np.savez(tmp_path / "beam.npz", M=M, K=K, C=C)
    return M, K, C, str(tmp_path / "beam.npz")


@pytest.mark.parametrize("kappa", [0.0, KAPPA], ids=["linear", "cubic"])
def test_a_pushed_model_moves_as_its_matrices_say(model, kappa):
    *matrices, path = model
    structure = build_finite_elements(DOFS, path, modes=6, connections=STOP if kappa else None)
    force = lambda time: np.outer(push(time), [0.0, 1.0, 0.0])  # noqa: E731
    response = simulate(structure, force, TIME, method="dop853")
    for found, expected in zip(
        (response.displacement, response.velocity, response.acceleration),
        whole_model(*matrices, kappa=kappa, push=push), strict=True,
    ):  # fmt: skip
        assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()
    np.testing.assert_array_equal(response.force, force(TIME))
    assert response.coordinates.shape == (len(TIME), 2, 6)


def test_a_shaken_model_moves_as_its_matrices_say(model):
    *matrices, path = model
    structure = build_finite_elements(DOFS, path, modes=6, ground="1::2")
    nothing = lambda time: np.zeros((len(time), 3))  # noqa: E731
    absolute = simulate(structure, nothing, TIME, method="dop853", ground=shaking)
    relative = simulate(structure, nothing, TIME, method="dop853", ground=shaking, frame="relative")
    u, v, a = whole_model(*matrices, shaking=shaking)
    for found, expected in zip(
        (absolute.displacement, absolute.velocity, absolute.acceleration, relative.acceleration),
        (u, v, a, a - np.outer(shaking(TIME), [1.0, 1.0, 0.0])), strict=True,
    ):  # fmt: skip
        assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


def test_a_simulation_goes_on_from_its_coordinates(model):
    structure = build_finite_elements(DOFS, model[3], modes=4, connections=STOP)
    force = lambda time: np.outer(push(time), [0.0, 1.0, 0.0])  # noqa: E731
    response = simulate(structure, force, TIME, substeps=40)
    later = simulate(structure, force, TIME[30:], substeps=40, initial=response.state(30))
    np.testing.assert_allclose(later.displacement, response.displacement[30:], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(
    ("how", "setting"), [({"ground": shaking}, "system.ground"), ({"hold": "zero_order"}, "simulation.hold")]
)
def test_what_a_reduced_model_cannot_do_is_refused(model, how, setting):
    structure = build_finite_elements(DOFS, model[3], modes=4)
    assert refusal(simulate, structure, lambda time: np.zeros((len(time), 3)), TIME, **how).startswith(f"{setting}=")
