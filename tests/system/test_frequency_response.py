"""Frequency responses against equations of motion that are written out, and their slopes against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinn_cli.system.frequency_response import Acting, FrequencyResponse

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
