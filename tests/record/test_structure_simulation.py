"""Simulated responses of structures against equations of motion that are written out here and nowhere else."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pinn_cli.record.simulation import Simulation
from pinn_cli.record.steps import substeps_needed
from pinn_cli.system.topology import build_structure

# A steel frame of three storeys: cubic joints below, a stiffening brace from the ground, a sliding one above.
FRAME = build_structure(
    ["x1", "x2", "x3"],
    {"x1": 2000, "x2": 2000, "x3": 1500},
    {
        "storey_1": {"between": ["ground", "x1"], "law": "duffing", "c": 4500, "k": 1.5e6, "kappa": 1e10},
        "storey_2": {"between": ["x1", "x2"], "law": "linear", "c": 4200, "k": 1.4e6},
        "storey_3": {"between": ["x2", "x3"], "law": "linear", "c": 3600, "k": 1.2e6},
        "brace": {"weights": {"x2": 1}, "law": "polynomial", "c": 0, "k": 1e5, "k_2": 2e7, "k_3": 5e9, "k_5": 1e13},
        "slide": {"weights": {"x1": -0.8, "x3": 0.8}, "law": "friction", "speed": 0.02, "c": 0, "k": 0, "F_c": 400},
    },
)  # fmt: skip
SPEED = 0.02


def force(t):
    """On the roof, N: three sines, so that the joint slides and sticks."""
    return (
        6e3 * np.sin(2 * np.pi * 1.7 * t) + 5e3 * np.sin(2 * np.pi * 4.1 * t + 0.3) + 3e3 * np.sin(2 * np.pi * 7.3 * t)
    )


def motion(t, y):
    x1, x2, x3, v1, v2, v3 = y
    storey_1 = 4500 * v1 + 1.5e6 * x1 + 1e10 * x1**3
    storey_2 = 4200 * (v2 - v1) + 1.4e6 * (x2 - x1)
    storey_3 = 3600 * (v3 - v2) + 1.2e6 * (x3 - x2)
    brace = 1e5 * x2 + 2e7 * x2**2 + 5e9 * x2**3 + 1e13 * x2**5
    slide = 400 * math.tanh(0.8 * (v3 - v1) / SPEED)
    a1 = (-storey_1 + storey_2 + 0.8 * slide) / 2000
    a2 = (-storey_2 + storey_3 - brace) / 2000
    a3 = (force(t) - storey_3 - 0.8 * slide) / 1500
    return [v1, v2, v3, a1, a2, a3]


@pytest.fixture(scope="module")
def reference():
    time = np.linspace(0.0, 1.0, 257)
    found = solve_ivp(motion, (0.0, 1.0), np.zeros(6), "DOP853", time, rtol=1e-11, atol=1e-15, max_step=1e-2)
    return time, found.y.T


@pytest.mark.parametrize("method", ["rk4", "dop853"])
def test_the_response_of_a_braced_frame_is_that_of_its_equations_written_out(reference, method):
    time, states = reference
    roof = np.array([0.0, 0.0, 1.0])
    simulation = Simulation(1.0, len(time), method=method)
    response = simulation.run(FRAME, lambda t: force(t)[:, None] * roof)
    for found, expected in ((response.displacement, states[:, :3]), (response.velocity, states[:, 3:])):
        error = np.sqrt(np.mean((found - expected) ** 2, axis=0) / np.mean(expected**2, axis=0))
        assert error.max() < 1e-6, error


def test_steps_are_short_enough_for_friction_at_rest():
    step = 1e-3
    sliding = FRAME.with_parameters(F_c=FRAME.parameters["F_c"] * 1e4)
    # 0.8 F_c / speed times 0.8 + 0.8 damps the lightest mass, which no spring does so fast.
    rate = 0.8 * 4e6 / SPEED * 2.0 / 1500
    assert substeps_needed(sliding, step) == pytest.approx(step * rate / 0.2, rel=0.01)
    assert substeps_needed(FRAME, step) < 10
