"""A solution under the noise that the last record of the same structure had: no search for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.network import NetworkDesign
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.quantities import FORCE
from pinn_cli.training.evidence import Evidence, Trained, converged
from pinn_cli.training.levels import floor, updated
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseLevels, NoiseModel
from pinn_cli.training.record_scales import force_and_velocity_scale
from pinn_cli.training.steps.discrepancy_search import SUSPICIOUS_DISCREPANCY
from pinn_cli.training.steps.windows_discrepancy import discrepancy_unit

# Part of the force below which a discrepancy is not begun with: the first solution starts at rest.
LEAST_START = 1e-4
# Factor on the number of features below which finer ones are not worth it.
WORTHWHILE = 1.1
# Relative decrease of the loss below which a softer solution is near enough to its end.
ON_THE_WAY = 1e-2


def solve_under_known_levels(evidence: Evidence, noise: NoiseLevels) -> Trained | None:
    """The solution under the levels of the problem's model; None where it has none, or they explain nothing.

    The discrepancy is taken for as large a part of the force as it was. A structure that is not linear is first solved
    under softer physics, which forgives a start at rest. Without a model the levels would start at ``noise``, whose
    discrepancy is the force that acts.
    """
    problem = evidence.problem.first
    if problem.spectral is not None:
        return _under_levels(evidence, noise, problem.spectral.levels)
    if problem.earlier_levels is None:
        return None
    levels, equations = problem.earlier_levels, evidence.equations.by_record[0]
    if not np.isfinite(levels.discrepancy) or not levels.force > 0:
        return None
    force, _ = force_and_velocity_scale(problem)
    rate = (levels.step / problem.record.step * equations.refinement) ** 0.5
    known_discrepancy = levels.discrepancy * rate * force / levels.force
    if levels.windows is not None:
        known_discrepancy = levels.windows.start * discrepancy_unit(evidence)
    discrepancy = max(known_discrepancy, LEAST_START * force)
    if discrepancy > SUSPICIOUS_DISCREPANCY * force * rate:
        return None
    known_noise = noise.each(_with_known_response, levels.sensors).with_discrepancy(discrepancy)
    of_force = levels.sensors.get("force")
    known_noise = known_noise.each(lambda noise: replace(noise, force=_known_where(noise.force, of_force)))
    point = evidence.equations.start()
    try:
        # Uncertain springs times a motion are no linear force either: physics is stiff after a window, and where
        # forces or the ground are functions that are found with the motion.
        stiff = levels.windows is not None or not equations.dynamics.is_plain
        bilinear = stiff and len(problem.uncertain) > 0
        if bilinear or not problem.structure.has_linear_laws:
            softer = converged(evidence.train(softened(known_noise, force), point, ON_THE_WAY))
            if softer is None:
                return None
            point = softer.solution.point
        trained = converged(evidence.train(known_noise, point))
        if trained is None:
            return None
        return converged(_as_driven(evidence, trained, known_discrepancy) or trained)
    except DivergenceError:
        return None


def _under_levels(evidence: Evidence, noise: NoiseLevels, levels: Mapping[str, np.ndarray]) -> Trained | None:
    """The solution under levels that spectra say; what disturbs the motion is no more than the load cell's."""
    least = LEAST_START * force_and_velocity_scale(evidence.problem.first)[0]
    discrepancy = float(max(np.nanmax(levels[FORCE]), least))
    known_noise = noise.each(_with_known_response, levels).with_discrepancy(discrepancy)
    return evidence.train(known_noise, evidence.equations.start())


def softened(noise: NoiseLevels, force: float) -> NoiseLevels:
    """The same with physics so soft that it forgives where a solution begins; the force that acts is ``force`` (N)."""
    return noise.with_discrepancy((noise.discrepancy * force) ** 0.5)


def softer_point(evidence: Evidence, noise: NoiseLevels, point: Point) -> Point:
    """Where a solution under stiff physics begins: at that under softer physics, found from a point on.

    Parameters that are uncertain times a motion are no linear force: from elsewhere stiff physics may get stuck. Where
    even the softer one cannot be solved it is the point itself.
    """
    force, _ = force_and_velocity_scale(evidence.problem.first)
    softer = evidence.train(softened(noise, force), point, ON_THE_WAY)
    return point if softer is None else softer.solution.point


def _as_driven(evidence: Evidence, trained: Trained, discrepancy: float) -> Trained | None:
    """The solution under what drives the ground and forces in this record; None where neither is unknown.

    Sensors come after that: under another drive they would be taken for noisier or better than they are, and a short
    record does not tell enough of them to find back.
    """
    if trained.noise.records[0].innovation is None:
        return None
    (driven,) = evidence.each_record(updated, trained, evidence.each_record(floor, trained))
    noise = trained.noise.each(lambda own: replace(own, discrepancy=discrepancy, innovation=driven.innovation))
    return evidence.train(noise, trained.solution.point)


def as_fine_as_before(design: NetworkDesign, problem: Problem, network: LinearReadout) -> NetworkDesign:
    """A design, whose network this is, with as many features a second as the model's record turned out to need."""
    assert problem.earlier_levels is not None
    factor = problem.earlier_levels.features * problem.record.duration / network.count
    return design.finer(factor, problem.record) or design if factor >= WORTHWHILE else design


def _with_known_response(noise: NoiseModel, levels: Mapping[str, np.ndarray]) -> NoiseModel:
    return replace(noise, response={q: _known_where(level, levels.get(q)) for q, level in noise.response.items()})


def _known_where(start: np.ndarray, level: np.ndarray | None) -> np.ndarray:
    """Levels of sensors that there are, as they were if they were there."""
    if level is None or level.shape[0] > start.shape[0]:
        return start
    padded = np.pad(level, (0, len(start) - len(level)), constant_values=np.nan)
    return np.where(np.isfinite(start) & np.isfinite(padded) & (padded > 0), padded, start)
