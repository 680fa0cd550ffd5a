"""The force that acts where a load cell measures it: between what the motion takes and what was measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinn_cli.record.response import Response
from pinn_cli.training.noise_model import NoiseModel


def sensor_share(noise: NoiseModel) -> np.ndarray:
    """(functions,) weight of the measured force in the posterior mean, from 0 to 1; NaN where there is no load cell.

    The residual between the motion's force and the measured one is discrepancy plus sensor noise, so each is weighted
    by the other's variance.
    """
    model = noise.discrepancy**2
    return model / (model + noise.points_per_sample * noise.force**2)


def acting_force(response: Response, filtered: np.ndarray, noise: NoiseModel) -> Response:
    """The response with the posterior mean of the force on every DOF that has a load cell.

    Without model error that is the motion's force; with a model that is far off it is the filtered measurement.
    Elsewhere the force stays what the motion takes: on an unforced DOF it shows where the model is wrong.

    Args:
        response: Its force is the one that the motion takes.
        filtered: (N, n), the measured force as far as the features follow it.
        noise: Of sensors and model, in the same sampling.
    """
    forced = np.isfinite(noise.force[: response.force.shape[1]])
    share, force = sensor_share(noise)[: len(forced)][forced], response.force.copy()
    force[:, forced] += share * (filtered[:, forced] - force[:, forced])
    return replace(response, force=force)
