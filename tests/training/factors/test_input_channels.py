"""What the ground's sensor says of its motion is the same in however many intervals it is enforced."""

import numpy as np
import pytest
import torch

from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Record
from pinn_cli.scheme.problem import Problem, inputs_of
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.training.estimator import built
from pinn_cli.training.factors.input_channels import InputChannels
from pinn_cli.training.noise_model import FeatureProjection, first_output, output_features
from pinn_cli.training.normal_equations import NormalEquations

SAMPLES, RATE, LEVEL = 600, 100.0, 0.03
TIME = np.arange(SAMPLES) / RATE
TONES = np.random.default_rng(3).uniform([0.5, 0.0], [35.0, 2.0 * np.pi], (40, 2))


def moving(time: np.ndarray) -> np.ndarray:
    """A ground with content up to 0.7 of the Nyquist frequency, m/s^2."""
    return np.cos(2.0 * np.pi * TONES[:, 0] * time[:, None] + TONES[:, 1]).sum(1) / np.sqrt(20.0)


def posed(intervals: int, measured: np.ndarray) -> NormalEquations:
    structure = build_chain(2, Linear(), m=[2e3, 1.5e3], c=6e3, k=[8e5, 7.2e5])
    columns = {name: np.full((SAMPLES, 2), np.nan) for name in ("displacement", "velocity", "acceleration")}
    columns["acceleration"][:, 1] = np.sin(TIME)
    still, none = np.zeros((SAMPLES, 2)), np.ones(2, dtype=bool)
    record = Record(TIME, **columns, force=still, unforced=none, ground_acceleration=measured)
    problem = Problem(structure, record, (), inputs=inputs_of(structure, record))
    return NormalEquations(built(Spline(intervals=intervals), problem), problem)


def of_ground(equations: NormalEquations) -> InputChannels:
    return next(own for own in equations.channels if isinstance(own, InputChannels))


def left(equations: NormalEquations, ground) -> torch.Tensor:
    """(P, 1), what the sensor's rows leave of a motion of the ground, a function of time, at their points."""
    network, rows, at = equations.network, of_ground(equations), equations.dynamics.ground.start
    time = np.arange(TIME[0], TIME[-1], 1.0 / RATE / 12.0)
    segments = network.segments(torch.as_tensor(time))
    projection = FeatureProjection(first_output(network, segments), output_features(network, segments)[0])
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
    equations = posed(intervals, moving(TIME))
    slow = told(equations, lambda time: moving(time) + LEVEL * np.cos(2.0 * np.pi * 5.0 * time))
    assert slow == pytest.approx(0.5 * LEVEL**2, rel=0.15)


def test_an_alias_that_no_sample_shows_costs_as_much_as_noise():
    """cos(2 pi f t) - cos(2 pi (r - f) t) is 0 at all samples, and the structure feels the first."""
    equations = posed(1300, moving(TIME))
    alias = told(
        equations,
        lambda time: moving(time) + LEVEL * (np.cos(2.0 * np.pi * 5.0 * time) - np.cos(2.0 * np.pi * 95.0 * time)),
    )
    assert alias > 0.5 * LEVEL**2


@pytest.mark.parametrize("intervals", [900, 1300])
def test_what_is_left_in_the_band_is_the_noise_of_the_samples(intervals):
    noise = np.random.default_rng(5).normal(size=SAMPLES)
    equations = posed(intervals, moving(TIME) + LEVEL * noise)
    rows = of_ground(equations)
    in_band = rows.in_band(left(equations, moving)).square().sum() / rows.per_sample / SAMPLES
    assert float(in_band) == pytest.approx(LEVEL**2 * np.mean(noise**2), rel=0.1)
