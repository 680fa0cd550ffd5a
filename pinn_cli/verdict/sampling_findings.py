"""What nobody knows of a force or of the ground: how it goes on between its samples, where these come too rarely."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.between_samples import FIRST_ORDER_HOLD, held_by_lines
from pinn_cli.record.channels import channels
from pinn_cli.record.free_run import is_linear
from pinn_cli.record.spectrum import periodogram, reaches_nyquist
from pinn_cli.system.quantities import FORCE, GROUND
from pinn_cli.verdict.finding import Finding
from pinn_cli.verdict.noise_findings import noise_found
from pinn_cli.verdict.prediction import predicted

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import Estimate

# Standard deviations by which the responses to two motions with the same samples differ, all samples together: by so
# many a record would tell them apart.
TOLD_APART = 5.0
# The upper end of a spectrum, over the Nyquist frequency, and the part of a force's power there that is no noise of a
# load cell: a white force has a tenth of its power in it.
UPPER_END, MATTERS = 0.9, 0.02


def sampling_findings(problem: Problem, estimate: Estimate, structure: Structure) -> list[Finding]:
    """What the samples of forces and of the ground leave open, and nobody said.

    Args:
        problem: For the record.
        estimate: For the noise of its sensors.
        structure: With the estimated parameters.
    """
    return _rare_forces(problem.record) + _rare_ground(problem.record, estimate, structure)


def _rare_forces(record: Record) -> list[Finding]:
    """Forces with content up to the Nyquist frequency, such as white ones, where nobody said how they go on."""
    found = []
    for channel in channels(record, (FORCE,)) if record.assumed else ():
        frequency, power = periodogram(channel.measured, record.step)
        share = float(power[frequency > UPPER_END * frequency[-1]].sum() / power.sum()) if power.any() else 0.0
        if share < MATTERS:
            continue
        text = (
            f"the {channel.name} has content up to the Nyquist frequency, {0.5 / record.step:.4g} Hz: what acts between"
            " its samples is not known, and intervals may be too narrow"
        )
        remedy = "sample faster, or say what it does: data.intersample=zero_order_hold, first_order_hold, band_limited"
        found.append(Finding("intersample", channel.name, f"{text}; {remedy}"))
    return found


def _rare_ground(record: Record, estimate: Estimate, structure: Structure) -> list[Finding]:
    """That straight lines between the ground's samples would shake the structure differently, and nobody said."""
    ground = record.ground_acceleration
    if ground is None or not record.assumed or not is_linear(structure):
        return []
    (channel,) = channels(record, (GROUND,))
    if not reaches_nyquist(ground, record.step, float(np.nan_to_num(noise_found(estimate, channel)))):
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
