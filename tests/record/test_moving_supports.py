"""Structures on supports that move, against equations of motion that are written out here."""

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from pinn_cli.record.ensemble import Members, spread_of
from pinn_cli.record.free_run import free_run
from pinn_cli.record.inputs import SupportErrors
from pinn_cli.record.record import Record
from pinn_cli.system.quantities import SUPPORT
from pinn_cli.system.structure import Structure
from pinn_cli.system.topology import build_structure

M, C, K, KAPPA, F_C = (400.0, 300.0), (200.0, 150.0, 90.0), (9e4, 6e4, 2e4), 4e8, 60.0
OMEGA, SIZE = np.array([[5.0, 23.0], [9.0, 31.0]]), np.array([[6e-3, 2e-3], [4e-3, 1e-3]])
STEP = 0.01


def frame(friction: bool = False) -> Structure:
    """Two masses: one on a table, by a spring that stiffens or a contact, the other on a wall and on the ground."""
    law = {"law": "friction", "speed": 0.02, "F_c": F_C} if friction else {"law": "duffing", "kappa": KAPPA}
    connections = {
        "tie": {"between": ["table", "x1"], "c": C[0], "k": K[0], **law},
        "spring": {"between": ["x1", "x2"], "law": "linear", "c": C[1], "k": K[1]},
        "stay": {"weights": {"x2": 0.8, "wall": -0.6}, "law": "linear", "c": C[2], "k": K[2]},
        "post": {"between": ["ground", "x2"], "law": "linear", "c": 10.0, "k": 1e4},
    }
    return build_structure(["x1", "x2"], {"x1": M[0], "x2": M[1]}, connections, supports=["table", "wall"])


def moved(time: np.ndarray, order: int) -> np.ndarray:
    """(N, 2), displacement of the supports or a derivative of it."""
    phase = OMEGA * time[:, None, None] + np.array([0.0, 0.5 * np.pi])
    return (SIZE * OMEGA**order * np.sin(phase + 0.5 * np.pi * order)).sum(-1)


def by_hand(time: np.ndarray, friction: bool) -> tuple[np.ndarray, ...]:
    """Displacement, velocity and acceleration of the two masses from rest, (N, 2) each."""

    def acceleration(t, x1, x2, v1, v2):
        (s1, s2), (d1, d2) = (moved(np.array([t]), order)[0] for order in (0, 1))
        e, de = x1 - s1, v1 - d1
        r1 = C[0] * de + K[0] * e + (F_C * np.tanh(de / 0.02) if friction else KAPPA * e**3)
        r2 = C[1] * (v2 - v1) + K[1] * (x2 - x1)
        r3 = C[2] * (0.8 * v2 - 0.6 * d2) + K[2] * (0.8 * x2 - 0.6 * s2)
        return (r2 - r1) / M[0], (-r2 - 0.8 * r3 - 10.0 * v2 - 1e4 * x2) / M[1]

    options = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-13, "max_step": STEP}
    rate = lambda t, y: [*y[2:], *acceleration(t, *y)]  # noqa: E731
    y = solve_ivp(rate, (0.0, time[-1]), np.zeros(4), t_eval=time, **options).y
    return y[:2].T, y[2:].T, np.array([acceleration(t, *state) for t, state in zip(time, y.T, strict=True)])


def record_of(order: int, duration: float = 2.0) -> Record:
    time = np.arange(round(duration / STEP)) * STEP
    still, blank = np.zeros((len(time), 2)), np.full((len(time), 2), np.nan)
    begins = np.array([moved(np.zeros(1), k)[0] for k in (0, 1)])
    measured = {list(SUPPORT)[order]: moved(time, order)}
    unforced, names = np.ones(2, bool), ("table", "wall")
    return Record(
        time, still, blank, blank, still, unforced, supports=measured, support_names=names, supports_begin=begins
    )


@pytest.mark.parametrize(("order", "friction"), [(0, False), (1, False), (2, False), (0, True)])
def test_it_moves_as_the_equations_written_out_say(order, friction):
    record = record_of(order)
    found = free_run(frame(friction), record, None)
    inside = slice(None) if friction else slice(20, -20)  # what ends a record is interpolated less well
    expected = by_hand(record.time, friction)
    for given, true in zip((found.displacement, found.velocity, found.acceleration), expected, strict=True):
        assert np.sqrt(np.mean((given - true)[inside] ** 2)) < (5e-4 if friction else 1e-4) * np.sqrt(np.mean(true**2))
    for k in range(3):
        off = found.supports[inside, k] - moved(record.time, k)[inside]
        assert np.sqrt(np.mean(off**2)) < 1e-4 * 10.0**k * np.sqrt(np.mean(moved(record.time, k) ** 2)), k


def test_errors_of_a_displacement_and_of_an_acceleration():
    """A sensor's noise is a displacement's error as it is, and an acceleration's integrated twice: a random walk's."""
    for order in (0, 2):
        record = record_of(order, duration=10.0)
        sigma = np.array([2e-4, 0.0]) if order == 0 else np.array([0.05, 0.0])
        errors = SupportErrors.of(record, {list(SUPPORT)[order]: sigma})
        assert errors is not None
        drawn = errors.drawn(np.random.default_rng(0), len(record.time) - 1, np.zeros((400, 3, 2)))
        late = drawn[-1].std(axis=0)
        time = record.time[-1]
        walk = [0.05 * STEP**0.5 * time**1.5 / 3**0.5, 0.05 * (STEP * time) ** 0.5, 0.05]
        expected = [2e-4, 0.0, 0.0] if order == 0 else walk
        np.testing.assert_allclose(late[:, 0], expected, rtol=0.15)
        assert not late[:, 1].any()


def test_members_share_the_supports_and_not_their_errors():
    structure, record = frame().with_parameters(kappa=torch.zeros(1, dtype=torch.float64)), record_of(0, 3.0)
    parameters = {kind: np.tile(x, (200, 1)) for kind, x in structure.parameters_like(np.empty(0)).items()}
    about = free_run(structure, record, None)
    none = np.zeros((0, 2))
    still = spread_of(Members(parameters, np.zeros((200, 4)), none, 0), structure, record, about)
    assert still.displacement.max() < 1e-5 * np.abs(about.displacement).max()
    errors = SupportErrors.of(record, {"support_displacement": np.array([1e-4, 0.0])})
    spread = spread_of(Members(parameters, np.zeros((200, 4)), none, 0, carried=errors), structure, record, about)
    # Noise of a table as white noise of the spring's force (its damper matters little here).
    pushed = Members(parameters, np.zeros((200, 4)), np.array([[K[0] * 1e-4, 0.0]]), 1)
    expected = spread_of(pushed, structure, record, about)
    late = record.time > 1.5
    ratio = spread.displacement[late].mean(0) / expected.displacement[late].mean(0)
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)
