"""Finite-element models as users give them: files of matrices, modes and residual vectors."""

import logging

import numpy as np
import pytest
from beams import beam, deflection
from calls import refusal
from scipy.io import mmwrite, savemat
from scipy.sparse import csc_matrix, diags, eye, kron, save_npz

from pinn_cli.settings.errors import InputError
from pinn_cli.system.finite_elements import build_finite_elements
from pinn_cli.system.matrix_files import read_matrices
from pinn_cli.system.reduction import reduced_model

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


NOTHING = {"M": None, "K": None, "C": None}


@pytest.fixture
def matrices(tmp_path):
    M, K = beam(3)
    np.savez(tmp_path / "dense.npz", M=M.toarray(), K=K.toarray(), C=0.1 * M.toarray())
    savemat(tmp_path / "model.mat", {"M": M, "K": K.toarray()})
    for name, matrix in {"M": M, "K": K}.items():
        save_npz(tmp_path / f"{name}.npz", matrix)
        mmwrite(tmp_path / f"{name}.mtx", matrix)
        savemat(tmp_path / f"{name}.mat", {"stored": matrix})
        np.save(tmp_path / f"{name}.npy", matrix.toarray())
    return tmp_path


@pytest.mark.parametrize(
    ("files", "path", "names"),
    [
        (NOTHING, "dense.npz", ["M", "K", "C"]),
        pytest.param(NOTHING, "model.mat", ["M", "K"], marks=pytest.mark.apart),
        ({"M": "M.npz", "K": "K.npz", "C": None}, None, ["M", "K"]),
        ({"M": "M.mtx", "K": "K.mtx", "C": None}, None, ["M", "K"]),
        ({"M": "M.mat", "K": "K.mat", "C": None}, None, ["M", "K"]),
        ({"M": "M.npy", "K": "K.npy", "C": None}, None, ["M", "K"]),
        ({"M": None, "K": None, "C": "M.mtx"}, "model.mat", ["M", "K", "C"]),
    ],
)
def test_every_kind_of_file_gives_the_same_matrices(matrices, files, path, names):
    found = read_matrices(files, path, matrices)
    assert list(found) == names
    for name, expected in zip("MK", beam(3), strict=True):
        np.testing.assert_allclose(found[name].toarray(), expected.toarray(), rtol=1e-12)


@pytest.mark.parametrize(
    ("files", "path", "setting", "said"),
    [
        ({"M": "absent.npz"}, None, "system.M", "there is none at"),
        ({"M": "M.csv"}, None, "system.M", "ends in .npz, .npy, .mtx, .mat"),
        ({"M": None}, "M.mtx", "system.path", "give it as system.M"),
        ({"M": None}, "M.npy", "system.path", "give it as system.M"),
        ({"X": None}, "dense.npz", "system.path", "no matrix called X"),
        ({"M": "broken.npz"}, None, "system.M", "a readable .npz file"),
        ({"M": "broken.mat"}, None, "system.M", "a readable .mat file"),
        pytest.param({"M": "broken.mtx"}, None, "system.M", "a readable .mtx file", marks=pytest.mark.apart),
        ({"M": "objects.npz"}, None, "system.M", "a readable .npz file"),
        ({"M": "wide.npz"}, None, "system.M", "a square matrix"),
        ({"M": "triangle.npz"}, None, "system.M", "only one triangle"),
        ({"M": "nan.npz"}, None, "system.M", "finite numbers"),
        ({"M": "complex.npz"}, None, "system.M", "real numbers"),
        ({"M": "M.npz", "K": "large.npz"}, None, "system.K", "as large as M, 6 x 6"),
    ],
)
def test_what_is_no_matrix_is_refused_in_one_line(matrices, files, path, setting, said):
    for suffix in ("npz", "mat", "mtx"):
        (matrices / f"broken.{suffix}").write_bytes(b"nothing of the kind")
    one = np.eye(3)
    arrays = {
        "objects": np.array([{}], dtype=object), "wide": np.ones((2, 3)), "triangle": np.triu(one + 1),
        "nan": one * np.nan, "complex": one * 1j, "large": np.eye(7),
    }  # fmt: skip
    for name, array in arrays.items():
        np.savez(matrices / f"{name}.npz", M=array)
    told = refusal(read_matrices, files, path, matrices)
    assert told.startswith(f"{setting}=")
    assert said in told


@pytest.mark.apart
def test_a_file_that_asks_for_more_than_the_machine_has_ends_its_reader_alone(matrices):
    (matrices / "vast.mtx").write_text("%%MatrixMarket matrix array real general\n2000000 2000000\n1.0\n")
    with pytest.raises(InputError, match=r"^system\.K=vast\.mtx") as error:
        read_matrices({"M": "M.npz", "K": "vast.mtx"}, None, matrices)
    assert "\n" not in str(error.value)


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
