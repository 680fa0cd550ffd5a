"""Sensors with a calibration of their own, and the ground's, in however many intervals it is enforced."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from structures import braced

from pinn_cli.network.spline import Spline
from pinn_cli.record.channel import CALIBRATED, Calibration, Channel
from pinn_cli.record.record import Record
from pinn_cli.scheme.calibration import sensor_parameters
from pinn_cli.scheme.problem import Problem, inputs_of
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.training.estimator import built
from pinn_cli.training.factors.input_channels import InputChannels
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import FeatureProjection, NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.solver import starting_noise

TIME = 2.0 + 0.3 * np.arange(21)
OWN = np.sort(np.random.default_rng(3).uniform(TIME[0], TIME[-1], 34))
FOUR = {
    "gain": Calibration(1.2, 0.4, unknown=True),
    "offset": Calibration(0.3, 0.7, unknown=True),
    "drift": Calibration(-0.1, 0.2, unknown=True),
    "delay": Calibration(0.04, 0.05),
}


def posed(calibration=FOUR) -> tuple[NormalEquations, NoiseModel]:
    """Histories without physics; one accelerometer beside the channel, and one force on the first DOF."""
    structure, rng = braced(), np.random.default_rng(7)
    n, values = structure.ndof, rng.normal(size=len(OWN))
    channel = Channel("x", "acceleration", {1: 1.0}, OWN, values, calibration)
    columns = {name: np.full((len(TIME), n), np.nan) for name in ("displacement", "velocity", "acceleration")}
    columns["acceleration"][:, 1:] = np.stack((channel.history(TIME), rng.normal(size=len(TIME))), axis=1)
    force = np.zeros((len(TIME), n))
    force[:, 0] = rng.normal(size=len(TIME))
    record = Record(TIME, **columns, force=force, unforced=np.arange(n) > 0, calibrated=(channel,))
    problem = Problem(structure, record, sensor_parameters(record), inputs=inputs_of(structure, record))
    equations = NormalEquations(built(Spline(intervals=5), problem), problem)
    return equations, replace(starting_noise(equations), taken_up=np.array([7.3]))


def test_the_gain_has_a_loss_of_its_own_where_it_is_unknown():
    equations, noise = posed()
    point = equations.start()
    assert equations.losses(point, noise)["gain"] == pytest.approx(2.0 * 7.3 * np.log(1.2))
    assert equations.losses(point, replace(noise, taken_up=None))["gain"] == 0.0
    equations, noise = posed({})
    assert equations.losses(equations.start(), noise)["gain"] == 0.0


def test_samples_that_may_have_felt_motion_outside_the_record_are_left_out():
    """Delay 0.04 s, known to 0.05 s: three standard deviations either way. The features begin at 1.7 s."""
    record = np.linspace(0.0, 9.7, 500)
    late, on_time = (posed(known)[0] for known in (FOUR, {}))
    for equations, first, last in ((late, 1.7 + 0.19, 8.3 - 0.11), (on_time, 1.7, 8.3)):
        (rows,) = equations.channels[-1].channels
        rows.channel = replace(rows.channel, time=record, measured=record)
        np.testing.assert_array_equal(rows._inside(1.7, 8.3), (record >= first) & (record <= last))


def test_a_delay_beyond_the_record_s_reach_is_refused_and_takes_no_memory():
    """All samples then stood in the last interval, and every interval's features were held for as many."""
    equations, noise = posed()
    point, (rows,) = equations.start(), equations.channels[-1].channels
    place = next(i for i, parameter in enumerate(equations.uncertain) if parameter.kind == "delay")
    held = equations.losses(point, noise) and rows.moment(0.04).segments.mask.shape
    for by, finite in ((2.9, True), (-2.9, True), (3.1, False), (200.0, False)):
        far = point.parameters.clone()
        far[place] = by
        assert math.isfinite(equations.losses(Point(point.unknowns, far), noise)[CALIBRATED]) is finite
        assert rows._moment.segments.mask.shape[1] <= held[1] + 2


def test_what_is_left_of_every_sample_is_in_what_it_feels():
    equations, _ = posed()
    point = equations.start()
    (channels,) = (own for own in equations.channels if own.name == CALIBRATED)
    (channel,) = channels.channels
    left = channels.residuals_of_samples(point)["x"]
    assert (np.isfinite(left) == channel.kept).all()
    squares = float(channels.squares(point)[0])
    assert float(np.nansum(left**2)) == pytest.approx(squares / 1.2**2)


SAMPLES, RATE, LEVEL = 600, 100.0, 0.03
GROUND_TIME = np.arange(SAMPLES) / RATE
TONES = np.random.default_rng(3).uniform([0.5, 0.0], [35.0, 2.0 * np.pi], (40, 2))


def moving(time: np.ndarray) -> np.ndarray:
    """A ground with content up to 0.7 of the Nyquist frequency, m/s^2."""
    return np.cos(2.0 * np.pi * TONES[:, 0] * time[:, None] + TONES[:, 1]).sum(1) / np.sqrt(20.0)


def on_ground(intervals: int, measured: np.ndarray) -> NormalEquations:
    structure = build_chain(2, Linear(), m=[2e3, 1.5e3], c=6e3, k=[8e5, 7.2e5])
    columns = {name: np.full((SAMPLES, 2), np.nan) for name in ("displacement", "velocity", "acceleration")}
    columns["acceleration"][:, 1] = np.sin(GROUND_TIME)
    still, none = np.zeros((SAMPLES, 2)), np.ones(2, dtype=bool)
    record = Record(GROUND_TIME, **columns, force=still, unforced=none, ground_acceleration=measured)
    problem = Problem(structure, record, (), inputs=inputs_of(structure, record))
    return NormalEquations(built(Spline(intervals=intervals), problem), problem)


def of_ground(equations: NormalEquations) -> InputChannels:
    return next(own for own in equations.channels if isinstance(own, InputChannels))


def left(equations: NormalEquations, ground) -> torch.Tensor:
    """(P, 1), what the sensor's rows leave of a motion of the ground, a function of time, at their points."""
    network, rows, at = equations.network, of_ground(equations), equations.dynamics.ground.start
    time = np.arange(GROUND_TIME[0], GROUND_TIME[-1], 1.0 / RATE / 12.0)
    segments = network.segments(torch.as_tensor(time))
    projection = FeatureProjection(network, segments)
    weights = torch.zeros(network.count, equations.dynamics.size, dtype=torch.float64)
    weights[:, at] = projection.coefficients(torch.as_tensor(ground(time))[:, None])[:, 0]
    point = equations.start()
    point.unknowns[:] = equations.layout.unknowns(weights)
    residual = rows.residual(point)
    return rows.segments.scatter(residual)


def told(equations: NormalEquations, ground) -> float:
    """Mean square of what is left, per sample."""
    return float(left(equations, ground).square().sum()) / of_ground(equations).per_sample / SAMPLES


@pytest.mark.parametrize("intervals", [900, 1300, 2000])
def test_an_error_in_the_band_counts_the_same_in_however_many_intervals(intervals):
    equations = on_ground(intervals, moving(GROUND_TIME))
    slow = told(equations, lambda time: moving(time) + LEVEL * np.cos(2.0 * np.pi * 5.0 * time))
    assert slow == pytest.approx(0.5 * LEVEL**2, rel=0.15)


def test_an_alias_that_no_sample_shows_costs_as_much_as_noise():
    """cos(2 pi f t) - cos(2 pi (r - f) t) is 0 at all samples, and the structure feels the first."""
    equations = on_ground(1300, moving(GROUND_TIME))
    alias = told(
        equations,
        lambda time: moving(time) + LEVEL * (np.cos(2.0 * np.pi * 5.0 * time) - np.cos(2.0 * np.pi * 95.0 * time)),
    )
    assert alias > 0.5 * LEVEL**2


@pytest.mark.parametrize("intervals", [900, 1300])
def test_what_is_left_in_the_band_is_the_noise_of_the_samples(intervals):
    noise = np.random.default_rng(5).normal(size=SAMPLES)
    equations = on_ground(intervals, moving(GROUND_TIME) + LEVEL * noise)
    rows = of_ground(equations)
    in_band = rows.in_band(left(equations, moving)).square().sum() / rows.per_sample / SAMPLES
    assert float(in_band) == pytest.approx(LEVEL**2 * np.mean(noise**2), rel=0.1)
