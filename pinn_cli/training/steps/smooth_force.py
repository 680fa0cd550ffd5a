"""The story in which what the model leaves out is a smooth force.

A discrepancy is white: as rich as the features, so that a motion with one follows its sensors wherever they go. What a
model leaves out is mostly a force of the structure's own frequencies. So there is another story of the same record: on
every coordinate acts a force that nobody measured, a Gaussian process whose level and colour are the record's most
probable ones, and hardly any discrepancy. It is solved as such forces are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from torch import Tensor

from pinn_cli.scheme.inputs import with_every_force
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.settings.errors import InputError
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.point import Point
from pinn_cli.training.solver import Inference
from pinn_cli.training.steps.force_spectrum import spectrum_of_discrepancy
from pinn_cli.training.steps.unknown_forces import CORRELATION_ROUNDS, fit_force_spectrum, of_spectrum, set_force_level

# Part of the discrepancy that is left beside the force at first; its level follows the record. With less, parameters
# that have far to go take several times as many steps.
LEFT_BESIDE = 0.1
# Spectra at most, one after the other.
SPECTRA = 3


def fit_smooth_force(inference: Inference) -> Inference | None:
    """The same beside the story of a smooth force; None: the model holds, or the story cannot be told.

    A process needs features that are local; and it takes twice the functions, of which this machine may not hold all.
    """
    is_local = all(equations.averages is not None for equations in inference.evidence.equations.by_record)
    smooth = _with_force(inference) if inference.free and is_local else None
    if smooth is None:
        return None
    for _ in range(SPECTRA):
        better = fit_force_spectrum(smooth)
        if better is None:
            break
        smooth = better
    return replace(inference, smooth=set_force_level(smooth) or smooth)


def _with_force(inference: Inference) -> Inference | None:
    """The same motion under forces with the spectrum that the discrepancy has, then under their own level."""
    solver, before = inference.solver, inference.evidence.equations.by_record
    drives = inference.evidence.each_record(spectrum_of_discrepancy, inference.trained)
    records = list(zip(inference.problem, drives, inference.trained.noise.records, strict=True))
    problem = JointProblem.of(*(of_spectrum(with_every_force(one), drive) for one, drive, _ in records))
    try:
        evidence = solver.evidence(problem, [equations.network for equations in before])
    except InputError:  # memory
        return None
    pairs = list(zip(inference.by_record, evidence.equations.by_record, strict=True))
    points = [_beside_forces(point, plain, forced) for (plain, point), forced in pairs]
    levels = [
        _driven(noise, forced, noise.discrepancy if drive is None else drive.level)
        for (_, drive, noise), forced in zip(records, evidence.equations.by_record, strict=True)
    ]
    noise = replace(inference.trained.noise, records=tuple(levels))
    trained = evidence.train(noise, evidence.equations.joined(points))
    if trained is None:
        return None
    trained = solver.settled(evidence, trained, CORRELATION_ROUNDS)
    return replace(inference, evidence=evidence, trained=trained) if trained.solution.converged else None


def _beside_forces(point: Point, plain: NormalEquations, forced: NormalEquations) -> Point:
    """The same motion, with forces that are nothing yet."""
    weights = forced.target.force.new_zeros(forced.layout.count, forced.dynamics.size)
    weights[:, _others(forced)] = plain.layout.weights(point.unknowns)
    return Point(forced.layout.unknowns(weights), point.parameters)


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
    at = forced.dynamics.forces
    return np.delete(np.arange(forced.dynamics.size), at)


def _driven(noise: NoiseModel, forced: NormalEquations, level: float) -> NoiseModel:
    """The same noise, with forces that so much drives in the equation of a coordinate, N, for the discrepancy."""
    at = forced.dynamics.forces
    of_force, innovation = (
        np.insert(levels, at.start, np.full(at.stop - at.start, np.nan))
        for levels in (noise.force, np.full(len(noise.force), np.nan) if noise.innovation is None else noise.innovation)
    )
    # A force on a DOF is in every coordinate's equation by how far the DOF moves with it.
    driven = replace(noise, force=of_force, innovation=innovation, discrepancy=LEFT_BESIDE * noise.discrepancy)
    return driven.driven_by(level / forced.problem.structure.shapes.scale, at)
