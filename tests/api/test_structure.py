"""Structures and records that are built without the command."""

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.signal import StateSpace, lsim

from pinn_cli import InputError, Record, Structure

TIME = 0.01 * np.arange(800)
FORCE = 30.0 * np.sin(2.0 * np.pi * 1.3 * TIME) * np.exp(-0.3 * TIME)


@pytest.fixture
def chain() -> Structure:
    return Structure.chain(m=[4.0, 5.0, 6.0], c=2.0, k=[900.0, 800.0, 700.0])


def matrices(chain: Structure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    stretch = np.eye(3) - np.eye(3, k=-1)
    p = {kind: values.numpy() for kind, values in chain.parameters.items()}
    return np.diag(p["m"]), stretch.T @ np.diag(p["c"]) @ stretch, stretch.T @ np.diag(p["k"]) @ stretch


def test_modes_are_those_of_the_matrices(chain: Structure) -> None:
    mass, _, stiffness = matrices(chain)
    expected = np.sqrt(eigh(stiffness, mass, eigvals_only=True)) / (2.0 * np.pi)
    np.testing.assert_allclose(chain.modes()["frequency"], expected, rtol=1e-3)
    assert chain.modes().columns.tolist() == ["mode", "frequency", "damping_ratio", "shape_1", "shape_2", "shape_3"]


def test_a_simulated_response_is_that_of_the_matrices(chain: Structure) -> None:
    record = chain.simulate(TIME, {3: FORCE})
    mass, damping, stiffness = matrices(chain)
    inverse = np.linalg.inv(mass)
    a = np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ stiffness, -inverse @ damping]])
    b = np.vstack((np.zeros((3, 1)), inverse[:, 2:]))
    fine = np.linspace(0.0, TIME[-1], 10 * (len(TIME) - 1) + 1)
    smooth = 30.0 * np.sin(2.0 * np.pi * 1.3 * fine) * np.exp(-0.3 * fine)
    _, states, _ = lsim(StateSpace(a, b, np.eye(6), np.zeros((6, 1))), smooth, fine)
    np.testing.assert_allclose(record.displacement, states[::10, :3], atol=1e-5 * np.abs(states[:, :3]).max())
    assert isinstance(record, Record)
    assert record.unforced.tolist() == [True, True, False]


def test_forces_may_be_arrays_or_functions(chain: Structure) -> None:
    by_dof = chain.simulate(TIME, {3: FORCE})
    array = chain.simulate(TIME, np.stack((0.0 * FORCE, 0.0 * FORCE, FORCE), axis=1))
    function = chain.simulate(
        TIME, lambda t: np.stack([0 * t, 0 * t, 30.0 * np.sin(2.0 * np.pi * 1.3 * t) * np.exp(-0.3 * t)], axis=1)
    )
    np.testing.assert_array_equal(array.displacement, by_dof.displacement)
    np.testing.assert_allclose(function.displacement, by_dof.displacement, atol=1e-6)
    assert function.unforced.tolist() == by_dof.unforced.tolist()


def test_a_shaken_structure_and_one_that_is_let_go(chain: Structure) -> None:
    shaken = chain.simulate(TIME, ground_acceleration=np.sin(5.0 * TIME), frame="relative")
    inertia = chain.simulate(TIME, -np.sin(5.0 * TIME)[:, None] * np.array([4.0, 5.0, 6.0]))
    np.testing.assert_allclose(shaken.displacement, inertia.displacement, atol=1e-9)
    released = chain.simulate(TIME, initial=np.array([[0.01, 0.02, 0.03], [0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(released.displacement[0], [0.01, 0.02, 0.03])
    assert np.abs(released.displacement[-1]).max() < 0.03


def test_named_structures() -> None:
    own = {"A": 500.0, "beta": 30.0, "gamma": 20.0, "n": 1.0}
    assert Structure.chain("bouc_wen", ndof=2, m=4.0, c=2.0, k=900.0, **own).nonlinearity_name == "bouc_wen"
    connections = {
        "base": {"between": ["ground", "x1"], "law": "linear", "c": 4500.0, "k": 1.5e6},
        "top": {"between": ["x1", "x2"], "law": "duffing", "c": 4200.0, "k": 1.4e6, "kappa": 1e9},
    }
    frame = Structure.connected(["x1", "x2"], {"x1": 2000.0, "x2": 1500.0}, connections)
    record = frame.simulate(TIME, {"x2": 100.0 * FORCE})
    assert record.to_frame().columns.tolist()[-1] == "force.x2"
    assert frame.modes().columns.tolist()[-2:] == ["shape_x1", "shape_x2"]
    with pytest.raises(InputError, match=r"^system\.mass\.x1=nothing"):
        Structure.connected(["x1", "x2"], {"x1": None, "x2": 1500.0}, connections)


def test_noise_is_that_of_the_ratio(chain: Structure) -> None:
    clean = chain.simulate(TIME, {3: FORCE}).keep({"acceleration": [1, 3]})
    noisy = clean.with_noise(20.0, seed=4)
    left = noisy.acceleration[:, 0] - clean.acceleration[:, 0]
    ratio = 10.0 * np.log10(np.mean(clean.acceleration[:, 0] ** 2) / np.mean(left**2))
    assert ratio == pytest.approx(20.0, abs=0.5)
    assert np.isnan(noisy.acceleration[:, 1]).all()
    np.testing.assert_array_equal(noisy.acceleration, clean.with_noise(20.0, seed=4).acceleration)
    assert noisy.to_frame().columns.tolist() == ["t", "acceleration.1", "acceleration.3", "force.3"]


def test_what_cannot_be_built_or_simulated(chain: Structure) -> None:
    for build, told in (
        (lambda: Structure.chain(m=1.0, c=[1.0, 2.0], k=[1.0, 2.0, 3.0]), "system.c"),
        (lambda: Structure.chain("duffin", m=1.0, c=1.0, k=1.0), "law=duffin"),
        (lambda: Structure.chain(m=-1.0, c=1.0, k=1.0), "system.m"),
        (lambda: chain.simulate(TIME**2, {1: FORCE}), "time"),
        (lambda: chain.simulate(TIME, {4: FORCE}), "force=4"),
        (lambda: chain.simulate(TIME, {"roof": FORCE}), "force=roof"),
        (lambda: chain.simulate(TIME, {1: FORCE[:-1]}), r"force\[1\]"),
        (lambda: chain.simulate(TIME, FORCE), r"force=an array of shape"),
        (lambda: chain.simulate(TIME).with_noise(1e9), "noise.snr_db"),
    ):
        with pytest.raises(InputError, match=told):
            build()
