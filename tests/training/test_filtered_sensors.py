"""Accelerometers behind a high-pass filter, and tilting ones, whose filter or tilt is known or found."""

from dataclasses import replace

import numpy as np
import pytest
from lacking_records import K, calibrated_alike, high_passed, moved, posed, recorded
from solved_records import by_spline

from pinn_cli.record.channel import Calibration, Channel
from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.training.calibrated_record import as_calibrated
from pinn_cli.training.estimate import Estimate

CORNER = 0.5


def solved(record: Record) -> Estimate:
    return by_spline(posed(record))


def assert_right(estimate: Estimate, truth: Response) -> None:
    """Springs within four standard deviations, displacements in their bands."""
    for p in estimate.parameters:
        if p.kind == "k":
            assert abs(p.estimate - K[p.parameter.index]) < 4.0 * p.std < 0.01 * p.estimate
    inside = np.abs(estimate.response.displacement - truth.displacement) < 1.645 * estimate.std.displacement
    assert 0.75 < inside.mean() <= 1.0
    assert estimate.doubts == ()


@pytest.mark.parametrize(("ground", "order"), [(False, 1), (True, 2)])
@pytest.mark.slow
def test_behind_a_known_filter_displacements_are_in_their_bands(ground: bool, order: int):
    truth = moved(ground, 1, ())
    shown = dict(enumerate(high_passed(truth.acceleration, CORNER, order).T))
    record = calibrated_alike(recorded(truth, shown), order, high_pass=Calibration(CORNER))
    estimate = solved(record)
    assert_right(estimate, truth)
    left = as_calibrated(record, estimate).acceleration - estimate.response.acceleration
    assert (left.std(axis=0) < 0.02 * truth.acceleration.std(axis=0)).all()


@pytest.mark.parametrize("order", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_an_unknown_corner_is_found(order: int):
    truth = moved(False, 1, ())
    shown = dict(enumerate(high_passed(truth.acceleration, CORNER, order).T))
    estimate = solved(calibrated_alike(recorded(truth, shown), order, high_pass=Calibration(0.1, 10.0, unknown=True)))
    assert_right(estimate, truth)
    for p in estimate.parameters:
        if p.kind == "high_pass":
            assert abs(p.estimate - CORNER) < 4.0 * p.std < 0.1


@pytest.mark.slow
def test_an_unknown_tilt_is_found():
    truth = moved(True, 1, ())
    record = recorded(truth, {2: truth.acceleration[:, 2] + 3.0 * truth.displacement[:, 2]})
    unknown = {"tilt": Calibration(0.0, 40.0, unknown=True)}
    tilting = Channel("a3", "acceleration", {2: 1.0}, record.time, record.acceleration[:, 2], unknown)
    record = replace(record, calibrated=(tilting,))
    estimate = solved(record)
    assert_right(estimate, truth)
    left = as_calibrated(record, estimate).acceleration[:, 2] - estimate.response.acceleration[:, 2]
    assert left.std() < 0.3 * (3.0 * truth.displacement[:, 2]).std()
    (tilt,) = (p for p in estimate.parameters if p.kind == "tilt")
    assert abs(tilt.estimate - 3.0) < 4.0 * tilt.std < 1.0


def test_what_a_filter_passes_is_what_its_equation_says():
    """A sinusoid, against the filter's transfer function, once how it began has died away."""
    time = np.arange(4000) / 50.0
    for order in (1, 2):
        channel = Channel(
            "x", "acceleration", {0: 1.0}, time, time, {"high_pass": Calibration(CORNER)}, filter_order=order
        )
        s, w = 2j * np.pi * 1.3, 2.0 * np.pi * CORNER
        gain = s**order / (s + w if order == 1 else s**2 + 2.0**0.5 * w * s + w**2)
        passed = channel.passed(time, np.sin(2.0 * np.pi * 1.3 * time))
        expected = (gain * np.exp(s * time)).imag
        np.testing.assert_allclose(passed[2000:], expected[2000:], atol=1e-3)
        began = np.linalg.lstsq(channel.decays(time), passed - expected)[0]
        np.testing.assert_allclose(passed - expected, channel.decays(time) @ began, atol=1e-3)
