"""The determinant that turns a motion into the forces that make it."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from pinn_cli.training.record_evidence import log_density, seen_powers

DEGREE = 6


def random_equations(size: int, coupled: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses, one of them nothing, dampers and springs; the last function acts on the others and does not feel them."""
    rng = np.random.default_rng(size)
    mass, there = rng.uniform(1.0, 2.0, size), rng.uniform(size=(size, size)) < coupled
    damping, stiffness = (np.eye(size) + 0.1 * there * rng.normal(size=(size, size)) for _ in range(2))
    mass[1], damping[-1, :-1], stiffness[-1, :-1] = 0.0, 0.0, 0.0
    return mass, damping, 50.0 * stiffness


@pytest.mark.parametrize("coupled", [0.2, 1.0])
@pytest.mark.parametrize("size", [2, 7, 30])
@pytest.mark.parametrize("degree", [None, DEGREE])
def test_it_is_the_determinant_at_every_frequency(degree, size, coupled):
    mass, damping, stiffness = random_equations(size, coupled)
    seen = seen_powers(300, 20.0, degree)
    zeroth, first, second = seen[..., None, None]
    dense = zeroth * stiffness + 1j * first * damping - second * np.diag(mass)
    assert log_density(mass, damping, stiffness, seen) == pytest.approx(np.linalg.slogdet(dense)[1].sum(), rel=1e-12)


def test_a_damper_adds_half_its_rate_times_the_duration():
    duration, edge, mass, k = 100.0, 400.0, np.array([2.0]), np.array([[30.0]])
    seen = seen_powers(int(duration * edge / np.pi), edge, None)
    weak, strong = (log_density(mass, np.array([[c]]), k, seen) for c in (0.1, 0.3))
    assert strong - weak == pytest.approx(0.5 * duration * 0.2 / 2.0, rel=0.01)


def equations_of_splines(c: float, k: float, intervals: int) -> np.ndarray:
    """(intervals, weights), averages of u'' + c u' + k u over knot intervals of one second."""
    knots, points = np.arange(-DEGREE, intervals + DEGREE + 1.0), (np.arange(8) + 0.5) / 8
    rows = np.zeros((intervals, intervals + DEGREE))
    for i in range(intervals):
        for j in range(i, i + DEGREE + 1):
            one = BSpline.basis_element(knots[j : j + DEGREE + 2], extrapolate=False)
            rows[i, j] = np.mean(one.derivative(2)(i + points) + c * one.derivative()(i + points) + k * one(i + points))
    return rows


@pytest.mark.parametrize("k", [1.0, 9.0, 12.0, 20.0])
def test_it_is_that_of_averaged_splines_up_to_and_beyond_their_band(k):
    """A resonance at the edge of the band, pi rad/s, and above it; the ends of the record add a little."""
    seen = seen_powers(150, np.pi, DEGREE)
    exact, found = [], []
    for stiffness in (0.25, k):
        rows = equations_of_splines(0.3, stiffness, 150)
        exact.append(np.log(np.linalg.svd(rows, compute_uv=False)).sum())
        found.append(log_density(np.ones(1), np.array([[0.3]]), np.array([[stiffness]]), seen))
    assert found[1] - found[0] == pytest.approx(exact[1] - exact[0], rel=0.04)
