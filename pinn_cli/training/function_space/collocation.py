"""The record at as many points as it has independent values, low-passed first, so that no point is wasted.

A Gauss-Newton step in function space costs up to the cube of the number of residuals. A record that is sampled far
beyond its band says no more in all its samples than their least-squares projection onto a spline of that band does at
as many points as the spline has features; sensor noise shrinks by what the projection takes out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.spline import Spline
from pinn_cli.physics import Targets
from pinn_cli.record.between_samples import evenly_spaced
from pinn_cli.record.channels import record_band
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import InputError
from pinn_cli.training.noise_model import FeatureProjection, NoiseModel, first_output, output_features
from pinn_cli.training.steps.first_solution import inferred_sensor_noise

# Points per period of the record's band; below that a motion between the points is seen by nothing.
FEWEST_PER_PERIOD = 2.5


@dataclass(frozen=True, eq=False)
class Collocation:
    """Targets at P points and the noise that they carry.

    Attributes:
        target: Its histories are (P, n).
        response: Quantity to the standard deviation of its noise at the points, (n,), NaN where there is no sensor.
        force: The same of the force sensors.
        filtered_force: (N, n), the measured forces at every sample, low-passed.
    """

    target: Targets
    response: dict[str, np.ndarray]
    force: np.ndarray
    filtered_force: np.ndarray

    def noise_model(self, discrepancy: float, continuity: float) -> NoiseModel:
        """Of the residuals at the points."""
        return NoiseModel(self.response, self.force, discrepancy, continuity)


def collocate(problem: Problem, all_targets: Targets, points: int | None, most_rows: int | None) -> Collocation:
    """The record at ``points`` uniform samples, low-passed to what a spline of its band can follow.

    Args:
        problem: Structure and record.
        all_targets: The record's targets at all its samples.
        points: P; None: as many as the spline has features, but no more than ``most_rows`` residuals in all.
        most_rows: See ``points``; None: any number.

    Raises:
        InputError: Too few points for the record's band, or the most rows allow no more.
    """
    record, target = problem.record, all_targets
    network = Spline().build(record)
    response, force = inferred_sensor_noise(problem)
    count = _points(problem, points, most_rows, network.count)
    samples = torch.as_tensor(evenly_spaced(len(record.time), count), device=all_targets.force.device)
    if network.count < len(record.time):
        target = _low_passed(target, network)
        kept = math.sqrt(network.count / len(record.time))
        response, force = {q: kept * sigma for q, sigma in response.items()}, kept * force
    return Collocation(target.at(samples), response, force, target.force.cpu().numpy())


def _points(problem: Problem, points: int | None, most_rows: int | None, features: int) -> int:
    record = problem.record
    available, band = len(record.time), record_band(record)
    least = min(available, math.ceil(FEWEST_PER_PERIOD * band * record.duration))
    channels = sum(int(record.sensors(quantity).sum()) for quantity in RESPONSE_QUANTITIES) + record.ndof
    if points is None:
        points = min(features, available)
        points = points if most_rows is None else min(points, max(least, most_rows // channels))
    points = min(points, available)
    if points < least:
        hint = f"the record goes up to {band:.3g} Hz and lasts {record.duration:.4g} s"
        raise InputError("training.collocation_points", points, f"a whole number >= {least}, or null", hint)
    return points


def _low_passed(target: Targets, network: LinearReadout) -> Targets:
    segments = network.segments(target.observation_time.cpu())
    output = first_output(network, segments)
    features = output_features(network, segments)

    def smooth(values: Tensor, order: int) -> Tensor:
        rest = FeatureProjection(output, features[order]).residual(values.cpu())
        return values - torch.as_tensor(rest).to(values)

    response = {
        quantity: smooth(target.response[quantity], order) for order, quantity in enumerate(RESPONSE_QUANTITIES)
    }
    return replace(
        target, response=response, force=smooth(target.force, 0), observer_force=smooth(target.observer_force, 0)
    )
