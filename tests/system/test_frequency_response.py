"""Frequency responses against equations of motion that are written out, and their slopes against differences."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.frequency_response import Acting, FrequencyResponse, Seen, rivals_of
from pinn_cli.system.parameters import Parameter

OMEGA = np.array([0.7, 1.9, 5.0])
# Two masses: from the ground, or the support that moves, to the first one and on to the second.
STRETCH = np.array([[1.0, 0.0], [-1.0, 1.0]])
NOTHING = np.zeros(2)
INPUTS = [
    (np.array([0.0, 1.0]), NOTHING, NOTHING),
    (NOTHING, np.ones(2), NOTHING),
    (NOTHING, NOTHING, np.array([-1.0, 0.0])),
]
RESPONSE = FrequencyResponse(
    OMEGA,
    STRETCH,
    np.eye(2)[None],
    Acting.of(INPUTS, 2),
    np.array([2.0, 1.0]),
    3.0 + 0.2j * OMEGA[:, None] * np.ones(2),
)


def test_force_ground_and_support_move_two_masses_as_their_equations_say():
    for omega, found in zip(OMEGA, RESPONSE.value, strict=True):
        d = 3.0 + 0.2j * omega
        dynamic = np.array([[2.0 * d - 2.0 * omega**2, -d], [-d, d - omega**2]])
        pushes = np.array([[0.0, -2.0, d], [1.0, -1.0, 0.0]])  # by the force, the ground's acceleration, the support
        np.testing.assert_allclose(found, np.linalg.solve(dynamic, pushes), rtol=1e-12)


def test_slopes_are_those_of_the_values():
    mass, connection = np.array([0.3, -0.1]), np.outer(1.0 + 1j * OMEGA, [0.0, 0.4])
    ends = [
        replace(RESPONSE, mass=RESPONSE.mass + h * mass, connection=RESPONSE.connection + h * connection).value
        for h in (1e-6, -1e-6)
    ]
    np.testing.assert_allclose(RESPONSE.slope(mass, connection), (ends[0] - ends[1]) / 2e-6, atol=1e-8)


FRAME = build_chain(3, Linear(), m=[2e3, 2e3, 1.5e3], c=1e3, k=[8e6, 7.2e6, 5.6e6])
SPRINGS = [Parameter("k", i) for i in range(3)]
ROOF, EVERY = np.eye(3)[[2]], np.eye(3)


def seen(sensing: np.ndarray, shaken: bool = True) -> Seen:
    one, nothing = np.ones(3) * shaken, np.zeros(3)
    return Seen(sensing, Acting.of([(np.eye(3)[0] * (not shaken), one, nothing)], 3), 0.3, 20.0)


def frequencies(k: list[float]) -> np.ndarray:
    """Written out independently: rad/s."""
    stiffness = np.diag(np.add(k, [*k[1:], 0.0])) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    mass = np.array([2e3, 2e3, 1.5e3])
    return np.sqrt(np.linalg.eigvalsh(stiffness / np.sqrt(np.outer(mass, mass))))


def test_the_roof_of_a_shaken_frame_has_a_twin_with_the_same_frequencies():
    (other,) = rivals_of(FRAME, SPRINGS, seen(ROOF), 3)
    k = [other[p] for p in SPRINGS]
    assert k[0] > 1.5 * 8e6
    np.testing.assert_allclose(frequencies(k), frequencies([8e6, 7.2e6, 5.6e6]), rtol=1e-6)


def test_on_a_support_that_moves_it_has_the_twin_that_it_has_on_moving_ground():
    """The roof moves as the support does and as the frame does beside it: both are told by the same frequencies."""
    acting = Acting.of([(np.zeros(3), np.zeros(3), np.array([-1.0, 0.0, 0.0]))], 3)
    carried = replace(seen(ROOF), acting=acting)
    ((on_support,), (on_ground,)) = (rivals_of(FRAME, SPRINGS, one, 3) for one in (carried, seen(ROOF)))
    np.testing.assert_allclose([on_support[p] for p in SPRINGS], [on_ground[p] for p in SPRINGS], rtol=1e-4)


@pytest.mark.parametrize("looked_at", [seen(EVERY), seen(np.eye(3)[[0]], shaken=False)], ids=["all floors", "driven"])
def test_what_sensors_tell_apart_has_no_twin(looked_at: Seen):
    assert rivals_of(FRAME, SPRINGS, looked_at, 3) == []


def test_parameters_that_are_held_leave_no_room_for_a_twin():
    assert rivals_of(FRAME, SPRINGS[:1], seen(ROOF), 3) == []


def test_behind_a_spring_of_no_stiffness_nothing_is_felt_and_nothing_breaks():
    springs = torch.tensor([100.0, 1e-320, 80.0], dtype=torch.float64)  # of a solution at its lower bound
    structure = build_chain(3, Linear(), m=1.0, c=0.1, k=100.0).with_parameters(k=springs)
    one = np.eye(3)
    seen = Seen(one[[0, 2]], Acting.forces(one[:, [0]]), 0.5, 4.0)
    free = [p for p in structure.every_parameter() if p.kind == "k"]
    assert all(np.isfinite(list(other.values())).all() for other in rivals_of(structure, free, seen, 3))
