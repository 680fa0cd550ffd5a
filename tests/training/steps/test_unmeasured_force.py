"""A force that nobody measured on a structure with a cubic spring: its parameters, all unknown, and its history."""

import numpy as np
import pytest
from solved_records import by_spline

from pinn_cli.record.record import Record
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing
from pinn_cli.verdict.judge import judge

M, C, K, KAPPA = np.array([1000.0, 800.0]), np.array([900.0, 700.0]), np.array([3e5, 2.5e5]), 1.5e9
RATE, FINER, SAMPLES = 50.0, 8, 1500
# Part of the Nyquist frequency up to which the force is white, and the rms elongation that it makes, m.
BAND, STRETCH = 0.8, 0.01


def pushed(seed: int) -> tuple[Record, np.ndarray]:
    """Accelerations at 30 dB under a white force on the second mass, by Runge-Kutta's method; and that force (N,)."""
    rng, step = np.random.default_rng(seed), 1.0 / RATE / FINER
    spectrum = np.fft.rfft(rng.normal(size=SAMPLES * FINER))
    spectrum[np.fft.rfftfreq(SAMPLES * FINER, step) > BAND * 0.5 * RATE] = 0.0
    force = np.fft.irfft(spectrum, SAMPLES * FINER)
    force *= 900.0 / force.std()

    def rate(state: np.ndarray, load: float) -> np.ndarray:
        e, de = np.diff(state[:2], prepend=0.0), np.diff(state[2:], prepend=0.0)
        held = C * de + K * e + np.array([KAPPA, 0.0]) * e**3
        return np.concatenate([state[2:], (np.array([held[1], load]) - held) / M])

    state, found = np.zeros(4), []
    for one, two in zip(force, np.append(force[1:], 0.0), strict=True):
        a = rate(state, one)
        found.append([*state, *a[2:]])
        b = rate(state + step / 2 * a, 0.5 * (one + two))
        c = rate(state + step / 2 * b, 0.5 * (one + two))
        state = state + step / 6 * (a + 2 * b + 2 * c + rate(state + step * c, two))
    motion = np.array(found)[::FINER]
    acceleration = motion[:, 4:]
    noisy = acceleration + 10**-1.5 * acceleration.std(0) * rng.normal(size=acceleration.shape)
    nothing = np.full_like(noisy, np.nan)
    unknown = np.column_stack([np.zeros(SAMPLES), np.full(SAMPLES, np.nan)])
    record = Record(np.arange(SAMPLES) / RATE, nothing, nothing, noisy, unknown, np.array([True, False]))
    return record, force[::FINER]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_all_parameters_are_told_beside_a_force_that_nobody_measured(seed):
    record, force = pushed(seed)
    structure = build_chain(2, Duffing(), m=M, c=2.0 * C, k=0.7 * K, kappa=np.array([0.5 * KAPPA, 0.0]))
    unknown = ["c_*", "k_*", "kappa_1"]
    problem = StateParameter(unobserved=[], unknown=unknown, parameter_uncertainty=0.0).pose(structure, [record]).alone
    estimate = by_spline(problem)
    truth = {"c_1": C[0], "c_2": C[1], "k_1": K[0], "k_2": K[1], "kappa_1": KAPPA}
    for p in estimate.parameters:
        assert abs(p.estimate - truth[p.name]) < 4.0 * p.std
        assert abs(p.estimate / truth[p.name] - 1.0) < (0.02 if p.name.startswith("k_") else 0.15)
    inside = slice(50, -50)
    left = np.mean((estimate.response.force[inside, 1] - force[inside]) ** 2) / np.mean(force[inside] ** 2)
    assert left < 0.08
    assert judge(problem, estimate).word == "sound"
