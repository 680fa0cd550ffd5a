"""Finite-element models of beams (Euler and Bernoulli), for tests."""

import numpy as np
from scipy.linalg import eigh
from scipy.signal import lsim
from scipy.sparse import csc_matrix, lil_matrix


def beam(
    elements: int,
    length: float = 1.0,
    bending_stiffness: float = 50.0,
    mass_per_length: float = 1.0,
    clamped: bool = True,
) -> tuple[csc_matrix, csc_matrix]:
    """Consistent mass matrix and stiffness matrix of a beam of uniform cross-section.

    DOFs are deflection (m) and slope of every node from the left end on; a clamped end has none. So of a clamped beam
    the deflection of node i is DOF 2 i - 1, counted from 1.

    Args:
        elements: How many.
        length: m.
        bending_stiffness: N m^2.
        mass_per_length: kg/m.
        clamped: Whether the left end is; otherwise nothing holds the beam.
    """
    h = length / elements
    mass = np.array([
        [156.0, 22 * h, 54.0, -13 * h],
        [22 * h, 4 * h**2, 13 * h, -3 * h**2],
        [54.0, 13 * h, 156.0, -22 * h],
        [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
    ])  # fmt: skip
    M = _assembled(elements, range(elements), mass_per_length * h / 420.0 * mass, clamped)
    return M, beam_part(elements, range(elements), length, bending_stiffness, clamped)


def beam_part(
    elements: int, own: range, length: float = 1.0, bending_stiffness: float = 50.0, clamped: bool = True
) -> csc_matrix:
    """Stiffness of some elements of the beam alone, in all its DOFs."""
    h = length / elements
    stiffness = np.array([
        [12.0, 6 * h, -12.0, 6 * h],
        [6 * h, 4 * h**2, -6 * h, 2 * h**2],
        [-12.0, -6 * h, 12.0, -6 * h],
        [6 * h, 2 * h**2, -6 * h, 4 * h**2],
    ])  # fmt: skip
    return _assembled(elements, own, bending_stiffness / h**3 * stiffness, clamped)


def _assembled(elements: int, own: range, of_element: np.ndarray, clamped: bool) -> csc_matrix:
    size = 2 * (elements + 1)
    matrix = lil_matrix((size, size))
    for element in own:
        at = slice(2 * element, 2 * element + 4)
        matrix[at, at] += of_element
    held = slice(2 if clamped else 0, None)
    return csc_matrix(matrix[held, held])


def deflection(node: int) -> int:
    """DOF of a node's deflection in a clamped beam, both counted from 1."""
    return 2 * node - 1


def response(
    M: csc_matrix, K: csc_matrix, ratio: float, load: tuple[int, np.ndarray], step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Displacement, velocity and acceleration (N, DOFs) of the whole model, at rest at first, under one force.

    Args:
        M: Mass matrix, kg.
        K: Stiffness matrix, N/m.
        ratio: Damping ratio of every mode.
        load: The DOF that carries it, counted from 1, and the force (N,), N; straight lines between its samples.
        step: Of the samples, s.
    """
    at, force = load
    squares, shapes = eigh(K.toarray(), M.toarray())
    n, c = len(squares), 2.0 * ratio * np.sqrt(squares)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(squares), -np.diag(c)]])
    b = np.concatenate((np.zeros(n), shapes[at - 1]))[:, None]
    time = step * np.arange(len(force))
    _, state, _ = lsim((a, b, np.eye(2 * n), np.zeros((2 * n, 1))), force, time)
    q, dq = state[:, :n], state[:, n:]
    ddq = np.outer(force, shapes[at - 1]) - squares * q - c * dq
    return q @ shapes.T, dq @ shapes.T, ddq @ shapes.T
