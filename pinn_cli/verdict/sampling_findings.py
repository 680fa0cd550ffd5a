"""What nobody knows of the ground's motion: how it goes on between its samples, where these come too rarely for it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.channels import channels
from pinn_cli.record.interpolation import FIRST_ORDER_HOLD, held_by_lines
from pinn_cli.record.spectrum import reaches_nyquist
from pinn_cli.verdict.finding import Finding
from pinn_cli.verdict.noise_findings import noise_found
from pinn_cli.verdict.prediction import is_linear, predicted

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import Estimate

# Standard deviations by which the responses to two motions with the same samples differ, all samples together: by so
# many a record would tell them apart.
TOLD_APART = 5.0


def sampling_findings(problem: Problem, estimate: Estimate, structure: Structure) -> list[Finding]:
    """That straight lines between the ground's samples would shake the structure differently, and nobody said.

    Args:
        problem: For the record.
        estimate: For the noise of its sensors.
        structure: With the estimated parameters.
    """
    record = problem.record
    ground = record.ground_acceleration
    if ground is None or not record.assumed or not is_linear(structure) or not reaches_nyquist(ground, record.step):
        return []
    told = _told_apart(structure, record, replace(record, ground_acceleration=held_by_lines(ground)), estimate)
    if told < TOLD_APART:
        return []
    text = (
        f"the ground's acceleration has content up to the Nyquist frequency, {0.5 / record.step:.4g} Hz, and how it"
        " goes on between its samples changes the response by more than the sensors' noise hides"
    )
    remedy = f"say what it does: data.intersample=band_limited, or {FIRST_ORDER_HOLD} if straight lines join them"
    return [Finding("intersample", "ground", f"{text}; {remedy}")]


def _told_apart(structure: Structure, record: Record, other: Record, estimate: Estimate) -> float:
    """Standard deviations by which responses to the inputs of two records differ, of the sensor that tells most."""
    one, two = predicted(structure, record), predicted(structure, other)
    if one is None or two is None:
        return 0.0
    told = [0.0]
    for channel in channels(record):
        noise = noise_found(estimate, channel)
        if noise > 0:
            told.append(float(np.linalg.norm(channel.of(one.response) - channel.of(two.response)) / noise))
    return max(told)
