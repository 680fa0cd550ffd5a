"""The exact motion of linear structures against a method of order eight, and against what is known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pinn_cli.record.between_samples import Held
from pinn_cli.record.free_run import free_run, has_modes, linear_motion
from pinn_cli.record.record import Record
from pinn_cli.record.simulation import simulate
from pinn_cli.system import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.modes import Modes

TIME = np.linspace(3.0, 5.0, 41)
START = np.array([[0.1, -0.2, 0.05], [0.3, 0.1, -0.4]])


def force(at):
    """(M, 3), N: on the first and the last DOF, up to 0.8 of the Nyquist frequency."""
    out = np.zeros((len(at), 3))
    out[:, 0], out[:, 2] = np.sin(3.0 * at) + np.cos(50.0 * at), np.sin(17.0 * at + 0.3)
    return out


CHAINS = {
    "light": {"m": 10.0, "c": 1.0, "k": 1500.0},
    "undamped": {"m": 10.0, "c": 0.0, "k": 15.0},
    "overdamped": {"m": 10.0, "c": 900.0, "k": [15.0, 20.0, 30.0]},
    "stiff": {"m": 10.0, "c": 5.0, "k": [15.0, 1e5, 20.0]},
}


def moved(structure, load, start=START):
    modes = Modes.of(structure)
    assert has_modes(modes)
    return linear_motion(modes, [(load, np.eye(structure.coordinates) / modes.m)], TIME, start)


@pytest.mark.parametrize("hold", ["exact", "zero_order"])
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name == "stiff" else name for name in CHAINS]
)
def test_it_is_that_of_a_method_of_order_eight(name, hold):
    structure = build_chain(3, Linear(), **CHAINS[name])
    load = force if hold == "exact" else Held(TIME, force(TIME))
    u, v = moved(structure, load)
    expected = simulate(structure, force, TIME, hold, "dop853", initial=START)
    for found, true in ((u, expected.displacement), (v, expected.velocity)):
        np.testing.assert_allclose(found, true, atol=(3e-5 if name == "stiff" else 1e-7) * np.abs(true).max())


def test_a_free_decay_is_known_by_hand():
    structure = build_chain(1, Linear(), m=2.0, c=0.4, k=50.0)
    u, v = moved(structure, lambda at: np.zeros((len(at), 1)), START[:, :1])
    pole, t = np.roots([2.0, 0.4, 50.0])[0], TIME - TIME[0]
    wave = np.exp(pole * t)
    b = (START[1, 0] - pole.real * START[0, 0]) / pole.imag
    expected = START[0, 0] * wave.real + b * wave.imag
    np.testing.assert_allclose(u[:, 0], expected, atol=1e-12)
    np.testing.assert_allclose(v[0], START[1, :1], atol=1e-12)


def test_critical_damping_is_no_hindrance():
    structure = build_chain(1, Linear(), m=2.0, c=20.0, k=50.0)
    record = Record(TIME, np.ones((41, 1)), *[np.full((41, 1), np.nan)] * 2, np.ones((41, 1)), np.array([False]))
    t = TIME - TIME[0]
    expected = 0.02 + np.exp(-5.0 * t) * (0.08 + (0.3 + 5.0 * 0.08) * t)
    found = free_run(structure, record, START[:, :1])
    np.testing.assert_allclose(found.displacement[:, 0], expected, atol=1e-6)


@pytest.mark.parametrize("samples", [64, 20_000])
def test_records_of_any_length_are_the_same_motion(samples):
    structure = build_chain(3, Linear(), **CHAINS["light"])
    modes, time = Modes.of(structure), 0.05 * np.arange(samples)
    u, v = linear_motion(modes, [(force, np.eye(3) / modes.m)], time, START)
    half = samples // 2
    later = linear_motion(modes, [(force, np.eye(3) / modes.m)], time[half:], (u[half], v[half]))
    np.testing.assert_allclose(later[0], u[half:], atol=1e-9)
