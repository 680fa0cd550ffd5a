"""Pieces of a long record that are integrated side by side: what one step after the other gives."""

from __future__ import annotations

import numpy as np
import pytest
from small_problems import small_chain

from pinn_cli.record import runge_kutta as one_by_one
from pinn_cli.record.runge_kutta import LEAST_STEPS, runge_kutta_step, shot
from pinn_cli.record.simulation import StateEquation, simulate

STEP, STEPS = 0.05, 20 * LEAST_STEPS + 7


def loads(n: int, size: float = 1.0, steps: int = STEPS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of a force on the first DOF that has resonances in its band."""
    time = 0.5 * STEP * np.arange(2 * steps + 1)
    force = np.zeros((len(time), n))
    force[:, 0] = size * sum(np.cos(2.0 * np.pi * f * time + 9.0 * f) for f in np.linspace(0.05, 1.0, 20))
    return force[:-1:2], force[1::2], force[2::2]


def stepped(slope, start, parts) -> np.ndarray:
    states = [start]
    for load in zip(*parts, strict=True):
        states.append(runge_kutta_step(slope, states[-1], *load, STEP))
    return np.array(states)


@pytest.mark.parametrize(
    ("kind", "n", "size"), [("duffing", 1, 0.3), ("van_der_pol", 2, 0.3), ("linear", 2, 1.0), ("duffing", 6, 0.3)]
)
def test_all_states_are_those_of_single_steps(kind, n, size):
    slope, start = StateEquation(small_chain(kind, n), False).slope, 0.01 * np.ones((2, n))
    expected = stepped(slope, start, loads(n, size))
    found = shot(slope, start, loads(n, size), STEP)
    assert found is not None
    np.testing.assert_array_equal(found[0], start)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def test_many_coordinates_that_move_fast_are_left_to_single_steps():
    slope = StateEquation(small_chain("duffing", 24), False).slope
    assert shot(slope, np.zeros((2, 24)), loads(24, 0.3), STEP) is None


def test_pieces_that_cannot_be_joined_are_left_to_single_steps():
    chain = small_chain("duffing", 1)
    slope = StateEquation(chain, False).slope
    with np.errstate(over="ignore", invalid="ignore"):
        assert shot(slope, np.zeros((2, 1)), loads(1, 1e12), STEP) is None


@pytest.mark.parametrize("hold", ["exact", "zero_order"])
def test_a_long_simulation_is_the_same_both_ways(hold, monkeypatch):
    def force(t: np.ndarray) -> np.ndarray:
        return np.cos(1.3 * t)[:, None] + np.cos(2.1 * t)[:, None]

    chain, time = small_chain("duffing", 1), np.linspace(0.0, 120.0, 2001)
    together = []
    monkeypatch.setattr(one_by_one, "shot", lambda *given: together.append(1) or shot(*given))
    alone = simulate(chain, force, time, hold)
    assert not together
    monkeypatch.setattr(one_by_one, "MANY_STEPS", 1000)
    found = simulate(chain, force, time, hold)
    assert together
    for given, expected in zip((found.displacement, found.velocity), (alone.displacement, alone.velocity), strict=True):
        np.testing.assert_allclose(given, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())
