"""Sensors that the estimated chain, left to itself under the measured force, does not reproduce."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.verdict.comparison import Comparison, comparisons
from pinn_cli.verdict.estimated import drawn_chain
from pinn_cli.verdict.finding import Finding
from pinn_cli.verdict.noise_findings import sigma
from pinn_cli.verdict.prediction import predicted

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.scheme.problem import Problem
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
        prediction: Of the estimated chain; None: it is unstable or too stiff, which is a finding where every force is
            known.
    """
    if prediction is None:
        if not np.isfinite(problem.record.force).all():
            return []
        text = "the estimated chain is unstable or too stiff for a free run; check units, masses and the time axis"
        return [Finding("free_run", "model", text, "failed")]
    noise = {c.channel.name: _noise_share(c, estimate) for c in comparisons(prediction)}
    bad = [c for c in comparisons(prediction) if c.misfit > max(GOOD, ALLOWED * noise[c.channel.name])]
    if not bad:
        return []
    moved = _propagated(problem, estimate, prediction, bad)
    return [
        _told(c) for c in bad if c.misfit > ALLOWED * (noise[c.channel.name] + moved.get(c.channel.name, 0.0)) + GOOD
    ]


def _told(c: Comparison) -> Finding:
    text = f"the free run does not reproduce the {c.channel.name}: NMSE {c.misfit:.2g}"
    remedy = "check that sensor and the parameters near it"
    word = "failed" if c.misfit > NOT_AT_ALL else "questionable"
    return Finding("free_run", c.channel.name, f"{text}; {remedy}", word)  # type: ignore[arg-type]


def _noise_share(c: Comparison, estimate: Estimate) -> float:
    """Of the sensor's noise in its mean square; what is called noise for half of it or more is no excuse."""
    level = sigma(estimate, c.channel.quantity, c.channel.dof)
    share = level**2 / c.power
    return share if np.isfinite(share) and share < 0.25 else 0.0


def _propagated(
    problem: Problem, estimate: Estimate, prediction: Prediction, bad: Sequence[Comparison]
) -> dict[str, float]:
    """NMSE by channel that the noise of the load cells and the parameters' deviations may cause, from a few draws."""
    random = np.random.default_rng(0)
    total = dict.fromkeys((c.channel.name for c in bad), 0.0)
    start = estimate.response.displacement[0], estimate.response.velocity[0]
    for _ in range(DRAWS):
        record = _disturbed(prediction.record, estimate, random)
        other = predicted(drawn_chain(problem, estimate, random), record, start)
        if other is None:
            continue
        for c in bad:
            change = c.channel.of(other.response) - c.channel.of(prediction.response)[: len(other.record.time)]
            total[c.channel.name] += float(np.mean(change**2)) / c.power / DRAWS
    return total


def _disturbed(record: Record, estimate: Estimate, random: np.random.Generator) -> Record:
    """The record with as much noise again on every measured force."""
    force = record.force.copy()
    for dof in np.flatnonzero(record.sensors("force")):
        level = sigma(estimate, "force", int(dof))
        if np.isfinite(level):
            force[:, dof] += level * random.normal(size=len(force))
    return replace(record, force=force)
