"""Sensors with a calibration of their own: the loss of an unknown gain, and samples beyond the reach of a delay."""

import math
from dataclasses import replace

import numpy as np
import pytest
from structures import braced

from pinn_cli.network.spline import Spline
from pinn_cli.record.channel import CALIBRATED, Calibration, Channel
from pinn_cli.record.record import Record
from pinn_cli.scheme.calibration import sensor_parameters
from pinn_cli.scheme.problem import Problem, inputs_of
from pinn_cli.training.estimator import built
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.point import Point
from pinn_cli.training.starting_noise import starting_noise

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
