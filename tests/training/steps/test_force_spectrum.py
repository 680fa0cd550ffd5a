"""Tests of the spectrum of forces that nobody measured, as a solution shows it."""

from __future__ import annotations

import numpy as np
import pytest

from pinn_cli.system.functions import FLAT, Inputs
from pinn_cli.training.steps.force_spectrum import DriveSpectrum, _fitted, levels_of_a_kind

EDGE = 20.0
FREQUENCY = np.arange(1, 1201) / 60.0


def drawn(power: np.ndarray, seed: int = 0) -> DriveSpectrum:
    """White noise of so much power at each frequency (F,), for two forces, all of it determined."""
    scatter = np.random.default_rng(seed).exponential(size=(len(FREQUENCY), 2))
    return DriveSpectrum(FREQUENCY, power[:, None] * scatter, np.ones_like(scatter))


@pytest.mark.parametrize("corner", [0.4, 2.0, np.inf], ids=["a slow wind", "a fast one", "white"])
def test_the_most_probable_process_has_the_spectrum_of_the_forces_in_their_band(corner):
    flat = Inputs(forces=(0, 1), correlation_time=2.0 * FLAT / (2.0 * np.pi * EDGE), edge=2.0 * np.pi * EDGE)
    gain = np.hypot(1.0 - (FREQUENCY / EDGE) ** 2, 2.0 * FLAT * FREQUENCY / EDGE)
    true = 9.0 / (1.0 + (FREQUENCY / corner) ** 2)
    (now, _), (best, drive) = _fitted(drawn(true * gain**2), flat, gain)
    omega = 2.0 * np.pi * FREQUENCY
    found = (drive.levels[:, None] ** 2) / (
        (1.0 - (omega * drive.correlation_time / (2.0 * drive.damping_ratio)) ** 2) ** 2
        + (omega * drive.correlation_time) ** 2
    )
    assert best > now
    assert np.abs(found / true - 1.0).max() < 0.35


@pytest.mark.parametrize("end", [1.2, 12.0, np.inf])
def test_forces_end_where_their_power_falls_at_once(end):
    seen = drawn(np.where(end > FREQUENCY, 4.0, 0.01))
    assert seen.end == pytest.approx(end, rel=0.015)
    np.testing.assert_allclose(seen.up_to(seen.end).levels, 2.0, rtol=0.1)


@pytest.mark.parametrize(
    "power", [(1.0 + FREQUENCY) ** -2.0, np.where(np.abs(FREQUENCY - 10.0) < 1.0, 0.01, 4.0)], ids=["slow", "a gap"]
)
def test_forces_that_fall_off_slowly_or_come_back_do_not_end(power):
    assert drawn(power).end == np.inf


def test_levels_of_a_kind_are_their_own_where_they_are_determined_and_common_where_not():
    own = levels_of_a_kind(np.array([900.0, 100.0, 0.0]), np.array([900.0, 900.0, 0.0]))
    together = np.sqrt(1000.0 / 1800.0)
    np.testing.assert_allclose(own, [1.0, 1.0 / 3.0, together], rtol=0.05)
