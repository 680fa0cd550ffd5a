"""Sensors that the estimated structure, left to itself under the measured force, does not reproduce."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.channels import channels
from pinn_cli.record.response import GROUND
from pinn_cli.system.quantities import SUPPORT
from pinn_cli.training.estimated_structure import estimated_structure
from pinn_cli.verdict.finding import Finding, failed_if
from pinn_cli.verdict.noise_findings import noise_found
from pinn_cli.verdict.prediction import Comparison, comparisons, predicted

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import Estimate
    from pinn_cli.verdict.prediction import Prediction

# NMSE of a free run that needs no excuse, and how many times the excuses' sum it may be: a few draws tell a mean
# square to within a factor of two or so. At half, nothing is reproduced.
GOOD, ALLOWED, NOT_AT_ALL = 0.05, 4.0, 0.5
DRAWS = 2


def sensor_findings(problem: Problem, estimate: Estimate, prediction: Prediction | None) -> list[Finding]:
    """Channels whose NMSE is larger than sensor noise, the force's noise and the parameters' deviations allow.

    Args:
        problem: With the prescribed chain.
        estimate: With the noise levels and the parameters.
        prediction: Of the estimated structure; None: it is unstable or too stiff, which is a finding where every
            force is known.
    """
    if prediction is None:
        if not np.isfinite(problem.record.force).all():
            return []
        text = "the estimated structure is unstable or too stiff for a free run; check units, masses and the time axis"
        return [Finding("free_run", "model", text, "failed")]
    every = comparisons(prediction)
    noise = {c.channel.name: _noise_share(c, estimate) for c in every}
    bad = [c for c in every if c.misfit > max(GOOD, ALLOWED * noise[c.channel.name])]
    if not bad:
        return []
    moved = _propagated(problem, estimate, prediction, bad)
    excuse = {c.channel.name: noise[c.channel.name] + moved[c.channel.name] for c in bad}
    return [_not_reproduced(c) for c in bad if c.misfit > ALLOWED * excuse[c.channel.name] + GOOD]


def _not_reproduced(c: Comparison) -> Finding:
    text = f"the free run does not reproduce the {c.channel.name}: NMSE {c.misfit:.2g}"
    remedy = "check that sensor and the parameters near it"
    return Finding("free_run", c.channel.name, f"{text}; {remedy}", failed_if(c.misfit > NOT_AT_ALL))


def _noise_share(c: Comparison, estimate: Estimate) -> float:
    """Of the sensor's noise in its mean square; what is called noise for half of it or more is no excuse."""
    share = noise_found(estimate, c.channel) ** 2 / c.power
    return share if np.isfinite(share) and share < 0.25 else 0.0


def _propagated(
    problem: Problem, estimate: Estimate, prediction: Prediction, bad: Sequence[Comparison]
) -> dict[str, float]:
    """NMSE by channel that the noise of the load cells and the parameters' deviations may cause, from a few draws."""
    random = np.random.default_rng(0)
    total = dict.fromkeys((c.channel.name for c in bad), 0.0)
    start = estimate.response.state(0)
    for _ in range(DRAWS):
        record = _disturbed(prediction.record, estimate, random)
        other = predicted(random_structure(problem, estimate, random), record, start)
        if other is None:
            continue
        for c in bad:
            change = c.channel.of(other.response) - c.channel.of(prediction.response)[: len(other.record.time)]
            total[c.channel.name] += float(np.mean(change**2)) / c.power / DRAWS
    return total


def _disturbed(record: Record, estimate: Estimate, random: np.random.Generator) -> Record:
    """The record with as much noise again on every measured force, and on the motion of ground and supports."""
    force, ground = record.force.copy(), record.ground_acceleration
    supports = {quantity: values.copy() for quantity, values in record.supports.items()}
    for sensor in channels(record, ["force", GROUND, *SUPPORT]):
        level = noise_found(estimate, sensor)
        noise = (level if np.isfinite(level) else 0.0) * random.normal(size=len(force))
        if sensor.quantity == GROUND:
            ground = sensor.measured + noise
        elif sensor.quantity in SUPPORT:
            supports[sensor.quantity][:, sensor.dof] += noise
        else:
            force[:, sensor.dof] += noise
    return replace(record, force=force, ground_acceleration=ground, supports=supports)


def random_structure(problem: Problem, estimate: Estimate, random: np.random.Generator) -> Structure:
    """The estimated structure with every parameter off by its standard deviation at random, correlations allowed for.

    Signs are kept: a stiffness that is known to itself has no negative values.
    """
    std = np.nan_to_num([p.std for p in estimate.parameters])
    z = random.normal(size=len(std))
    if estimate.correlation is not None and len(std):
        values, vectors = np.linalg.eigh(np.nan_to_num(estimate.correlation))
        z = vectors @ (np.sqrt(np.maximum(values, 0.0)) * z)
    moved = [
        replace(p, estimate=value) if (value := p.estimate + float(move)) * p.estimate > 0 else p
        for p, move in zip(estimate.parameters, std * z, strict=True)
    ]
    return estimated_structure(problem.structure, moved)
