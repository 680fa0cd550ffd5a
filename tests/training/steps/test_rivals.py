"""Two storeys on a shaken ground: an accelerometer on the roof sees the same of two structures.

Of the roof's motion u_2 = (1 - m_1 m_2 s^4 / D) u_g and D = k_1 k_2 + (...) s^2 + m_1 m_2 s^4 only k_1 k_2 and
(k_1 + k_2) m_2 + k_2 m_1 are seen. With equal masses k_1 = 2 k_2' and k_2 = k_1' / 2 of the other one.
"""

import numpy as np
import pytest
from scipy.signal import cont2discrete
from solved_records import by_spline

from pinn_cli.record.record import Record
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear

M, K, RATIO = 1000.0, np.array([3.0e6, 1.0e6]), 1e-3
OTHER = np.array([2.0 * K[1], K[0] / 2.0])


def shaken(seed: int) -> Record:
    """10 s at 100 Hz, the ground's acceleration held between 2000 samples a second and known, the roof's at 40 dB."""
    rng, fine, rate = np.random.default_rng(seed), 2000.0, 100.0
    time = np.arange(round(10.0 * fine)) / fine
    lines = np.arange(0.5, 20.0, 0.1)
    ground = np.cos(2.0 * np.pi * np.outer(time, lines) + rng.uniform(0.0, 2.0 * np.pi, len(lines))).sum(axis=1)
    stiffness = np.array([[K.sum(), -K[1]], [-K[1], K[1]]]) / M
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -RATIO * stiffness]])
    b = np.array([[0.0], [0.0], [-1.0], [-1.0]])
    step, load, *_ = cont2discrete((a, b, np.eye(4), np.zeros((4, 1))), 1.0 / fine)
    states = np.zeros((len(time), 4))
    for i in range(len(time) - 1):
        states[i + 1] = step @ states[i] + load[:, 0] * ground[i]
    roof = (states @ a[3])[:: round(fine / rate)]  # what moves it, over its mass: the absolute acceleration
    nothing = np.full((len(roof), 2), np.nan)
    measured = nothing.copy()
    measured[:, 1] = roof + 0.01 * roof.std() * rng.standard_normal(len(roof))
    return Record(
        time[:: round(fine / rate)], nothing, nothing.copy(), measured, np.zeros_like(nothing), np.ones(2, bool),
        ground_acceleration=ground[:: round(fine / rate)],
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("near", [K, OTHER], ids=["one", "the other"])
@pytest.mark.parametrize("as_whole", [False, True], ids=["dampers", "rayleigh"])
def test_of_two_structures_that_do_the_same_the_one_nearer_to_what_is_said_is_reported(near, as_whole):
    said = (near * np.array([0.8, 1.2])).tolist()
    damping = {"damping": {"rayleigh": [0.0, RATIO]}} if as_whole else {"c": (RATIO * K).tolist()}
    chain = build_chain(2, Linear(), m=M, k=said, **damping)
    unknown = ["k_*"] if as_whole else ["k_*", "c_*"]
    problem = StateParameter(unobserved=[], unknown=unknown).pose(chain, [shaken(0)]).alone
    estimate = by_spline(problem)
    found = {p.name: p.estimate for p in estimate.parameters}
    assert [found["k_1"], found["k_2"]] == pytest.approx(near, rel=0.03)
    (rival,) = estimate.rivals
    assert abs(rival.log_odds) < 6.0
