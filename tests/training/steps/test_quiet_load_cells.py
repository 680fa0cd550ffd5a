"""A load cell whose force is as white as noise: what the model lacks is not its noise."""

from functools import cache

import numpy as np
import pytest
from lacking_records import RATE, C, K, M, posed
from scipy.signal import lsim
from solved_records import by_spline

from pinn_cli.record.record import Record
from pinn_cli.training.estimate import Estimate

SAMPLES, FINER, LEVEL = 1000, 8, 0.01


@cache
def estimated(heavier: float) -> Estimate:
    """Of three storeys, of which the lowest is so much heavier than its model says, under a force up to Nyquist."""
    rng = np.random.default_rng(5)
    lines = rng.standard_normal((2, SAMPLES // 2 + 1)).T @ [1.0, 1.0j]
    padded = np.zeros(SAMPLES * FINER // 2 + 1, complex)
    padded[2 : SAMPLES // 2 - 10] = lines[2 : SAMPLES // 2 - 10]
    force = np.fft.irfft(padded)
    time = np.arange(len(force)) / (RATE * FINER)
    force *= 5e3 / force.std() * np.minimum(1.0, time)
    rows, mass = np.eye(3) - np.eye(3, k=-1), M * [heavier, 1.0, 1.0]
    k, c = (rows.T @ np.diag(x) @ rows for x in (K, C))
    a = np.block([[np.zeros((3, 3)), np.eye(3)], [-k / mass[:, None], -c / mass[:, None]]])
    b = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0 / mass[2]])[:, None]
    state = lsim((a, b, np.eye(6), np.zeros((6, 1))), force, time)[1]
    shown = (state @ a.T + force[:, None] * b.T)[::FINER, 3:]
    cell = np.zeros_like(shown)
    cell[:, 2] = force[::FINER]
    noisy = [x + LEVEL * x.std(axis=0) * rng.standard_normal(x.shape) for x in (shown, cell)]
    absent = np.full_like(shown, np.nan)
    record = Record(time[::FINER], absent, absent, *noisy, unforced=np.array([True, True, False]))
    return by_spline(posed(record))


@pytest.mark.slow
def test_what_the_model_lacks_is_no_noise_of_the_cell():
    estimate = estimated(1.15)
    assert estimate.noise.sensors["force"][2] < 2.0 * LEVEL * 5e3
    assert estimate.stories[0].name == "free run"
    assert (estimate.doubts[0].kind, estimate.doubts[0].of) == ("m", "DOF 1")


def test_noise_that_is_white_stays_noise():
    estimate = estimated(1.0)
    assert estimate.noise.sensors["force"][2] == pytest.approx(LEVEL * 5e3, rel=0.5)
    assert not estimate.stories
    assert not estimate.doubts
