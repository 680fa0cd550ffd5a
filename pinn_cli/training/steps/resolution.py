"""What a spline cannot follow of a motion, and how many knots it takes to follow it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from pinn_cli.network.spline import SplineNetwork
from pinn_cli.record.channels import record_band
from pinn_cli.record.spectrum import periodogram, pieces
from pinn_cli.system.basis import with_functions_of
from pinn_cli.system.parameters import FACTOR
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import FeatureProjection
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution

# The error of a spline's accelerations falls with this power of the knots.
ORDER = 5
# Part of a sensor's noise, of a spring's or of the motion's standard deviation, that the spline's own error may be:
# beyond it the spline should be finer.
TOLERATED = 0.3
# The same of the motion's where forces are not linear: they fold what the spline cannot follow back into its band.
TOLERATED_NONLINEAR = 0.15
# Knots in a piece of a record: with more it holds little of what soon dies out, and with fewer its lines are wide
# beside the slope of what a spline cannot follow. The loudest piece of a record that is alike everywhere has up to so
# many times the mean power of all.
KNOTS_IN_PIECE, LOUDEST_BY_CHANCE = 64, 8.0
# So far above the highest resonance a record still tells of stiffness.
BEYOND_RESONANCE = 1.3
# Draws from the posterior that tell how well the motion is known.
RESOLUTION_DRAWS = 4
# Most that the knots are multiplied by at once.
LARGEST_FACTOR = 2.0


def acceleration_error(evidence: RecordEvidence, solution: RecordSolution, content: float = np.inf) -> np.ndarray:
    """(dofs,) rms of what the spline cannot follow of the accelerations, m/s^2, in the piece of the record with most.

    Content at a frequency f comes with an image of it at r - f, with r knots a second, smaller by the power degree - 1
    of f / (r - f): that of the basis functions' spectrum, sinc to the power degree + 1, less two derivatives.
    What is no noise has no frequency above that of ``content``, Hz.
    """
    equations, network = evidence.equations, evidence.equations.network
    if not isinstance(network, SplineNetwork):
        return np.zeros(equations.problem.record.ndof)
    motion = equations.flat_states(equations.physics, solution.point).acceleration.numpy()
    motion = equations.dynamics.structure.shapes.of_dofs(motion[:, : equations.dynamics.ndof])
    rate, step = network.free_intervals, equations.problem.record.step / equations.refinement
    # What tells of a law with a memory is where it turns, in a few pieces.
    turns, errors = len(equations.dynamics.structure.memory) > 0, []
    for column in motion.T:
        cut = pieces(column, round(KNOTS_IN_PIECE / (rate * step)))
        frequency, power = periodogram(cut, step)
        below = frequency <= min(rate / 2.0, content)
        image = (frequency[below] / (rate - frequency[below])) ** (2 * (network.degree - 1))
        of_pieces = 2.0 * (power[:, below] @ image) / cut.shape[1]
        is_alike = not turns and of_pieces.max() <= LOUDEST_BY_CHANCE * of_pieces.mean()
        errors.append(np.sqrt(of_pieces.mean() if is_alike else of_pieces.max()))
    return np.array(errors)


def knots_wanted(evidence: RecordEvidence, solution: RecordSolution) -> float:
    """How many times the knots make the spline's error small against all that the record tells; at least 1.

    Of a linear structure there is content in the record's band and up to its highest resonance, which may have died out
    too soon to be seen: what is found beyond both is noise that finer features would only follow further.
    """
    equations = evidence.equations
    if equations.averages is None:
        return 1.0
    band, frequencies = record_band(equations.problem.record), _natural_frequencies(equations, solution)
    reached = max(band, BEYOND_RESONANCE * float(np.max(frequencies, initial=0.0)))
    error = acceleration_error(evidence, solution, reached if equations.dynamics.structure.has_linear_laws else np.inf)
    # A little above the highest natural frequency in the band.
    resonance = min(band, BEYOND_RESONANCE * float(max(frequencies[frequencies <= band], default=band)))
    wanted = max(
        _for_the_sensors(solution, error, band),
        _for_the_motion(evidence, solution, error),
        _for_the_parameters(evidence, solution, resonance),
    )
    return float(np.clip(wanted, 1.0, LARGEST_FACTOR))


def _for_the_motion(evidence: RecordEvidence, solution: RecordSolution, error: np.ndarray) -> float:
    """So many times the knots make the spline's error (dofs,) small against the deviation of every acceleration.

    Poor sensors of a structure that is known leave a motion that is known far better than they measure it.
    """
    equations = evidence.equations
    segments, square = equations.observation, np.zeros(len(error))
    for drawn in solution.drawn(RESOLUTION_DRAWS, of_mean_length=True):
        for part in equations.windows(segments):
            values = equations.dynamics.sensed("acceleration", equations.jet(segments, drawn, part))
            square += values.square().sum((0, 1)).numpy() / RESOLUTION_DRAWS
    std = np.sqrt(square / segments.samples)
    worst = float(np.max(error[std > 0] / std[std > 0], initial=0.0))
    tolerated = TOLERATED if equations.dynamics.structure.has_linear_laws else TOLERATED_NONLINEAR
    return float((worst / tolerated) ** (1.0 / ORDER))


def _for_the_sensors(solution: RecordSolution, error: np.ndarray, band: float) -> float:
    """So many times the knots make the spline's error (dofs,) small against every sensor's noise.

    An error of the accelerations is one of velocities and displacements at the record's highest frequencies.
    """
    omega, worst = 2.0 * np.pi * band, 0.0
    for order, quantity in enumerate(("acceleration", "velocity", "displacement")):
        ratio = error / omega**order / solution.noise.response[quantity]
        worst = max(worst, float(np.nanmax(ratio, initial=0.0)))
    return float((worst / TOLERATED) ** (1.0 / ORDER))


def _for_the_parameters(evidence: RecordEvidence, solution: RecordSolution, resonance: float) -> float:
    """So many times the knots make the error of the dynamic stiffness small against what is known of every spring."""
    equations = evidence.equations
    parameters = equations.parameters(solution.point)
    std = np.sqrt(np.diag(solution.factor.corner_covariance)) * equations.scale.numpy()
    relative = [
        s / float(parameters[p.kind][p.index])
        for s, p in zip(std, equations.uncertain, strict=True)
        if p.kind in ("k", FACTOR) and float(parameters[p.kind][p.index]) > 0
    ]
    if not relative:
        return 1.0
    network = equations.network
    assert isinstance(network, SplineNetwork)
    wanted = resonance * (1.0 + (TOLERATED * min(relative)) ** (-1.0 / network.degree))
    return wanted * network.spacing


def _natural_frequencies(equations: NormalEquations, solution: RecordSolution) -> np.ndarray:
    """(n,), with the mean tangent stiffness, Hz."""
    parameters, point = equations.parameters(solution.point), solution.point
    structure = equations.dynamics.structure
    stretch = structure.incidence.matrix.toarray()
    stiffness = equations.motion.mean_tangent(equations.observation, point)[0][: len(stretch)].numpy()
    root = np.sqrt(parameters["m"].numpy())
    rates = np.linalg.eigvalsh((stretch / root).T @ (stiffness[:, None] * (stretch / root)))
    frequencies: np.ndarray = np.sqrt(np.maximum(rates, 0.0)) / (2.0 * np.pi)
    return frequencies


def carried_over(point: Point, coarse: NormalEquations, fine: NormalEquations) -> Point:
    """The same motion and parameters in the features of a finer spline, in other coordinates, with other functions."""
    segments, times = fine.physics, fine.target.physics_time
    motion = coarse.flat_states(coarse.network.segments(times), point).displacement
    before, after = (equations.dynamics.structure.reduction for equations in (coarse, fine))
    if before is not None and after is not before:
        turn = torch.as_tensor(before.onto(after)).to(motion)
        n = len(turn)
        motion = torch.cat([motion[:, :n] @ turn.T, motion[:, n:]], 1)
    weights = FeatureProjection(fine.network, segments).coefficients(motion).to(motion)
    structure, values = coarse.problem.structure, coarse.parameters(point)  # and those of sensors
    of_structure = {kind: values[kind].detach().cpu() for kind in structure.parameters}
    moved = with_functions_of(replace(structure, parameters=of_structure), fine.problem.structure).parameters
    parameters = point.parameters.clone()
    for i, p in enumerate(fine.uncertain):
        if p.curve:
            parameters[i] = (moved[p.kind][p.index] - p.prescribed) / fine.scale[i]
    return Point(fine.layout.unknowns(weights), parameters)
