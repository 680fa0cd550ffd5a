"""Averages over knot intervals: how many there are, what they are of, and what they make of white noise."""

import numpy as np
import pytest
import torch

from pinn_cli.network.spline import SplineNetwork
from pinn_cli.scheme.problem import RINGS, TurningPoints
from pinn_cli.training.subdomains import INITIAL_CONDITIONS, Subdomains

DEGREE = 6


def averages(intervals: int = 40, points: int = 6, degree: int = DEGREE, step: float = 0.05) -> Subdomains:
    """Knot intervals with so many points each, half way between the knots."""
    network = SplineNetwork(2, 0.0, intervals * points * step, intervals, degree, "exact", torch.float64)
    return Subdomains(network.segments(step * (torch.arange(intervals * points, dtype=torch.float64) + 0.5)))


@pytest.mark.parametrize("degree", [4, 6, 8])
@pytest.mark.parametrize("points", [3, 4, 7])
@pytest.mark.parametrize("intervals", [8, 9, 40])
def test_there_are_as_many_as_features_without_initial_conditions(intervals, points, degree):
    assert averages(intervals, points, degree).count == intervals + degree - INITIAL_CONDITIONS


def test_every_point_is_in_one_average():
    found = averages(points=5)
    sample, mask = found.segments.sample.numpy(), found.segments.mask.numpy() > 0
    np.testing.assert_array_equal(np.sort(sample[mask]), np.arange(40 * 5))
    # Averages follow each other in time.
    begins = [row[there].min() for row, there in zip(sample, mask, strict=True)]
    assert np.all(np.diff(begins) > 0)


def test_an_interval_without_points_has_no_average():
    network = SplineNetwork(1, 0.0, 20.0, 20, DEGREE, "exact", torch.float64)
    time = 0.25 * (torch.arange(80, dtype=torch.float64) + 0.5)
    found = Subdomains(network.segments(time[(time < 10.0) | (time > 11.0)]))
    assert 10 not in found.interval.tolist()
    assert found.count == 20 + DEGREE - INITIAL_CONDITIONS


def test_an_average_is_the_mean_times_the_root_of_its_points():
    found = averages(intervals=10, points=4)
    history = torch.randn(40, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    given = found(found.segments.gather(history))[:, 0]
    mask, sample = found.segments.mask > 0, found.segments.sample
    for row, index, there in zip(given, sample, mask, strict=True):
        inside = history[index[there]]
        torch.testing.assert_close(row, inside.mean(0) * len(inside) ** 0.5)


def test_averages_of_white_noise_are_white_with_its_variance():
    found = averages(intervals=400)
    rng = np.random.default_rng(0)
    white = torch.as_tensor(3.0 * rng.normal(size=(400 * 6, 50)))
    given = found(found.segments.gather(white))[:, 0].numpy()
    assert given.std() == pytest.approx(3.0, rel=0.02)
    # At the divided ends too, and no average knows of its neighbour.
    for end in (given[:3], given[-3:]):
        assert end.std() == pytest.approx(3.0, rel=0.2)
    correlation = np.mean(given[1:] * given[:-1]) / given.var()
    assert abs(correlation) < 3.0 / np.sqrt(given.size)


def test_averages_by_interval_are_those_of_undivided_intervals():
    found = averages(intervals=12, points=5)
    history = torch.randn(60, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    given = found.by_interval(found(found.segments.gather(history)))
    torch.testing.assert_close(given, history.reshape(12, 5, 3).mean(1) * 5**0.5)


def dynamic_stiffness_error(degree: int, per_period: float) -> float:
    """Relative error of the restoring force of a sine, with a spline that has its averaged accelerations right."""
    periods, points = 30, 32
    intervals = int(periods * per_period)
    network = SplineNetwork(1, 0.0, float(intervals), intervals, degree, "exact", torch.float64)
    time = (torch.arange(intervals * points, dtype=torch.float64) + 0.5) / points
    found = Subdomains(network.segments(time))
    omega = 2.0 * np.pi / per_period
    sine = torch.sin(omega * time)[:, None]

    # m u'' + c u' + k u = f with the sine its exact solution: far from resonance, so that k is told.
    def rows(values: torch.Tensor) -> np.ndarray:
        local = found(values)[:, 0].numpy()
        out = np.zeros((found.count, network.count))
        np.put_along_axis(out, found.segments.feature.numpy(), local, axis=1)
        return out

    curvature, value = rows(found.segments.acceleration), rows(found.segments.displacement)
    right = found(found.segments.gather(sine))[:, 0, 0].numpy()
    weights = np.linalg.lstsq(np.vstack((curvature, 1e-6 * value)), np.r_[-(omega**2) * right, 1e-6 * right], None)[0]
    middle = slice(found.count // 3, 2 * found.count // 3)
    carried = (value @ weights)[middle]
    pure = np.stack((right, found(found.segments.gather(torch.cos(omega * time)[:, None]))[:, 0, 0].numpy()), 1)[middle]
    trend = np.stack((np.ones(len(pure)), np.arange(len(pure))), 1)
    return abs(np.linalg.lstsq(np.hstack((pure, trend)), carried, None)[0][0] - 1.0)


def test_the_dynamic_stiffness_is_off_by_the_power_of_the_degree():
    """By (f / (r - f))^degree, twice with both images: the module's own claim, for even degrees."""
    for degree, per_period in ((4, 4.0), (4, 6.0), (6, 4.0), (6, 6.0)):
        ratio = 1.0 / (per_period - 1.0)
        assert dynamic_stiffness_error(degree, per_period) == pytest.approx(ratio**degree, rel=0.7)


def test_averages_about_turns_count_for_less_and_the_others_as_ever():
    found, time = averages(), 0.05 * (torch.arange(240, dtype=torch.float64) + 0.5)
    turns = TurningPoints(np.array([3.01, 6.0, 6.4]), level=2.0, looser=10.0, discrepancy=1.0)
    near = turns.near(found.times(time), 0.3)
    distance = np.abs(found.times(time)[:, None] - turns.time).min(axis=1)
    np.testing.assert_array_equal(near, distance < RINGS * 0.3)
    assert 0.2 < near.mean() < 0.6
    values = found.segments.gather(torch.randn((240, 2), generator=torch.Generator().manual_seed(1)).double())
    loosened = found.loosened(torch.as_tensor(near), turns.looser)
    torch.testing.assert_close(loosened(values)[near], found(values)[near] / 10.0)
    assert torch.equal(loosened(values)[~near], found(values)[~near])
    assert not TurningPoints(np.zeros(0), 1.0, 1.0, 1.0).near(np.arange(5.0), 0.3).any()
