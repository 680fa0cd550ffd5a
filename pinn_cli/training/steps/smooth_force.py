"""The story in which what the model leaves out is a smooth force.

A discrepancy is white: as rich as the features, so that a motion with one follows its sensors wherever they go. What a
model leaves out is mostly a force of the structure's own frequencies. So there is another story of the same record: on
every coordinate acts a force that nobody measured, a Gaussian process whose level and colour are the record's most
probable ones, and hardly any discrepancy. It is solved as such forces are.
"""

from __future__ import annotations

from dataclasses import replace
from heapq import nlargest

import numpy as np
import torch
from torch import Tensor

from pinn_cli.scheme.problem import with_every_force
from pinn_cli.settings.errors import InputError
from pinn_cli.training.evidence import converged, model_log_evidence
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.solver import Inference
from pinn_cli.training.steps.force_spectrum import spectrum_of_discrepancy
from pinn_cli.training.steps.unknown_forces import CORRELATION_ROUNDS, fit_force_spectrum, of_spectrum, set_force_level

# Part of the discrepancy that is left beside the force at first; its level follows the record. With less, parameters
# that have far to go take several times as many steps.
LEFT_BESIDE = 0.1
# Spectra at most, one after the other.
SPECTRA = 3
# Logarithm of how many times as probable the record must be with a force on one DOF alone.
DECISIVE_PLACE = 10.0
# DOFs whose force is followed to its own noise levels: under those of forces on all DOFs the best one is hardly ever
# another.
FOLLOWED_PLACES = 2
# Relative decrease of the loss that ends a solution which only tells whether it is followed.
NEAR_ENOUGH = 1e-2


def fit_smooth_force(inference: Inference) -> Inference | None:
    """The same beside the story of a smooth force; None: the model holds, or the story cannot be told.

    A process needs features that are local; and it takes twice the functions, of which this machine may not hold all.
    """
    is_local = all(equations.averages is not None for equations in inference.evidence.equations.by_record)
    everywhere = _with_force(inference) if inference.free and is_local else None
    if everywhere is None:
        return None
    smooth = _of_own_spectrum(everywhere)
    return replace(inference, smooth=_on_one_dof(smooth, inference) or smooth)


def _of_own_spectrum(smooth: Inference) -> Inference:
    """The same with the spectra that make the record more probable; a force that is next to nothing has none."""
    for _ in range(SPECTRA):
        better = fit_force_spectrum(smooth)
        if better is None or not _log_evidence(better) > _log_evidence(smooth):
            break
        smooth = better
    return set_force_level(smooth) or smooth


def _on_one_dof(smooth: Inference, white: Inference) -> Inference | None:
    """The same story of one force alone, with which the record is far more probable; None: there is none.

    More probable than with smooth forces on all DOFs and than with white ones: either may come to rest anywhere.
    """
    forces = smooth.problem.first.inputs.forces
    alone = (one for number in range(len(forces)) if (one := _of_one(smooth, number)))
    # No more of them are held at once: each has a factor of its own.
    nearest = nlargest(FOLLOWED_PLACES, alone, key=_log_evidence) if len(forces) > 1 else []
    if not nearest:
        return None
    best = _of_own_spectrum(max(map(_settled, nearest), key=_log_evidence))
    gain = _log_evidence(best) - max(map(_log_evidence, (smooth, white))) - np.log(len(forces))
    return replace(best, log_odds_of_place=float(gain)) if gain > DECISIVE_PLACE else None


def place_of(smooth: Inference) -> str:
    """The DOF that the force acts on alone, for people; "" where it is any."""
    problem = smooth.problem.first
    return f"DOF {problem.record.dof_name(problem.inputs.forces[0])}" if smooth.log_odds_of_place else ""


def _log_evidence(inference: Inference) -> float:
    """That of problems with other functions can be compared with; an evidence that is not known is none."""
    log_evidence = model_log_evidence(inference.evidence, inference.trained)
    return log_evidence if np.isfinite(log_evidence) else -np.inf


def _of_one(smooth: Inference, number: int) -> Inference | None:
    """The story without all forces but one, which acts for all of them; None where it cannot be solved."""
    networks, points, levels = [], [], []
    for (before, point), noise in zip(smooth.by_record, smooth.trained.noise.records, strict=True):
        at = before.dynamics.forces
        networks.append(before.network)
        others = np.delete(np.arange(at.start, at.stop), number)
        points.append(np.delete(before.layout.weights(point.unknowns).numpy(), others, axis=1))
        assert noise.innovation is not None
        force, innovation = (np.delete(x, others) for x in (noise.force, noise.innovation))
        together = float(noise.innovation[at].sum())
        quiet = replace(noise, force=force, innovation=innovation)
        levels.append(quiet.driven_by(together, slice(at.start, at.start + 1)))
    problem = smooth.problem.changed(lambda p: replace(p, inputs=replace(p.inputs, forces=(p.inputs.forces[number],))))
    evidence = smooth.solver.evidence(problem, networks)
    pairs = zip(evidence.equations.by_record, points, smooth.by_record, strict=True)
    begun = [
        Point(forced.layout.unknowns(torch.as_tensor(weights)), point.parameters)
        for forced, weights, (_, point) in pairs
    ]
    same_levels = replace(smooth.trained.noise, records=tuple(levels))
    trained = evidence.train(same_levels, evidence.equations.joined(begun), NEAR_ENOUGH)
    return None if trained is None else replace(smooth, evidence=evidence, trained=trained)


def _settled(story: Inference) -> Inference:
    return replace(story, trained=story.solver.settled(story.evidence, story.trained, CORRELATION_ROUNDS))


def _with_force(inference: Inference) -> Inference | None:
    """The same motion under forces with the spectrum that the discrepancy has, then under their own level."""
    before, noise_before = inference.evidence.equations.by_record, inference.trained.noise
    drives = inference.evidence.each_record(spectrum_of_discrepancy, inference.trained)
    problem = inference.problem.changed(with_every_force).changed(of_spectrum, drives)
    try:
        evidence = inference.solver.evidence(problem, [equations.network for equations in before])
    except InputError:  # memory
        return None
    pairs = list(zip(inference.by_record, evidence.equations.by_record, strict=True))
    points = []
    for (plain, point), forced in pairs:  # the same motion, with forces that are nothing yet
        weights = forced.target.force.new_zeros(forced.layout.count, forced.dynamics.size)
        weights[:, _others(forced)] = plain.layout.weights(point.unknowns)
        points.append(Point(forced.layout.unknowns(weights), point.parameters))
    levels = [
        _driven(noise, forced, noise.discrepancy if drive is None else float(np.sqrt(np.mean(drive.levels**2))))
        for noise, drive, forced in zip(noise_before.records, drives, evidence.equations.by_record, strict=True)
    ]
    noise = replace(noise_before, records=tuple(levels))
    trained = evidence.train(noise, evidence.equations.joined(points))
    story = None if trained is None else _settled(replace(inference, evidence=evidence, trained=trained))
    return None if story is None or converged(story.trained) is None else story


def of_smooth_motion(inference: Inference) -> Tensor:
    """The unknowns of the solution itself at the motion of its smooth story, without the forces there."""
    smooth, equations = inference.smooth, inference.evidence.equations
    assert smooth is not None
    pairs = zip(equations.by_record, smooth.by_record, strict=True)
    points = [
        Point(plain.layout.unknowns(forced.layout.weights(point.unknowns)[:, _others(forced)]), point.parameters)
        for plain, (forced, point) in pairs
    ]
    return equations.joined(points).unknowns


def _others(forced: NormalEquations) -> np.ndarray:
    """All functions but the forces."""
    return np.delete(np.arange(forced.dynamics.size), forced.dynamics.forces)


def _driven(noise: NoiseModel, forced: NormalEquations, level: float) -> NoiseModel:
    """The same noise, with forces that so much drives in the equation of a coordinate, N, for the discrepancy."""
    at, innovation = forced.dynamics.forces, noise.innovation
    of_force, innovation = (
        np.insert(levels, at.start, np.full(at.stop - at.start, np.nan))
        for levels in (noise.force, np.full(len(noise.force), np.nan) if innovation is None else innovation)
    )
    # A force on a DOF is in every coordinate's equation by how far the DOF moves with it.
    driven = replace(noise, force=of_force, innovation=innovation, discrepancy=LEFT_BESIDE * noise.discrepancy)
    return driven.driven_by(level / forced.problem.structure.shapes.scale, at)
