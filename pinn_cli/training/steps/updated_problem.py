"""The same solution with its problem posed again as it asks for, and carried over: modes, turning points, features.

Where contacts stick or turn round no spline follows the corners of the motion. What it leaves of the equation of motion
in these intervals is its own error, ten times as large as anywhere else. As one level with all else it passes for a
force that the model leaves out: parameters are then known ten times as badly as the sliding tells them. So these
intervals have a level of their own, that of what is left in them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from pinn_cli.network.spline import SplineNetwork
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import TurningPoints
from pinn_cli.system.basis import bending_at, is_exact_at, reduced_at, shares_basis
from pinn_cli.system.parameters import FACTOR
from pinn_cli.training.evidence import Trained
from pinn_cli.training.minimise import Point
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.solver import Inference, Solver
from pinn_cli.training.steps.discrepancy_search import NEGLIGIBLE_GAIN, SCAN_FACTOR
from pinn_cli.training.steps.known_levels import WORTHWHILE, softer_point
from pinn_cli.training.steps.resolution import carried_over, knots_wanted

# A contact turns where it is slower than so many times the speed over which its friction does.
STRAIGHT_SPEEDS = 3.0
# Beyond this part of the intervals too few are left to learn from.
MOST_LOOSENED = 0.8
# How much larger the error is about turns where a solution with one level says less: that one spreads it over all.
FIRST_LOOSER = 10.0
# Relative change of damping's matrix below which modes are the same: beside what else is uncertain of damping that is
# nothing. So is what coordinates that are exact at factors so far off leave out: 1e-4 of the motion.
SAME_MODES, SAME_FACTORS = 2e-3, 5e-3
# Away from turns nothing is left to find where the discrepancy falls to no less than this part of it.
SAME_LEVEL = 0.7
# Finer features whose sensors come out so many times as noisy have not found the solution.
SUSPECT = 2.0


def with_turning_points(inference: Inference, problem: JointProblem) -> JointProblem:
    """The problem with the turning points of a solution of it; the same where all laws are smooth."""
    if problem.first.dynamics.structure is problem.first.structure:  # a contact's law is solved as another one
        return problem
    records = zip(inference.by_record, inference.trained.noise.records, strict=True)
    turning = [_turning_points(*solution, noise.discrepancy) for solution, noise in records]
    return problem.changed(lambda one, points: replace(one, turning_points=points), turning)


def _turning_points(equations: NormalEquations, point: Point, discrepancy: float) -> TurningPoints | None:
    """Those of one record, and how much larger the residual is about them; None where it is not."""
    if equations.averages is None:
        return None
    structure, time = equations.dynamics.structure, equations.target.physics_time
    rate = equations.flat_states(equations.physics, point).velocity
    rate = structure.elongation(equations.dynamics.stretching(rate))
    turning = torch.zeros(len(time), dtype=torch.bool)
    sticking = equations.problem.structure.groups
    for group, stuck, part in zip(structure.groups, sticking, structure.parts, strict=True):
        speed = group.nonlinearity.reversal_speed
        if group.nonlinearity is not stuck.nonlinearity and speed is not None:
            group_rate = rate[:, part.connections]
            turning |= (group_rate.abs() < STRAIGHT_SPEEDS * speed).any(1)
            turning[1:] |= (group_rate[1:] * group_rate[:-1] < 0).any(1)
    assert isinstance(equations.network, SplineNetwork)
    turns = TurningPoints(time[turning].numpy(), 1.0, 1.0, discrepancy)
    near = turns.near(equations.averages.times(time), equations.network.spacing)
    square = equations.motion.residual(point)[:, 0, equations.dynamics.has_mass].square().mean(1).numpy()
    if not 0.0 < near.mean() < MOST_LOOSENED:
        return None
    before = equations.problem.turning_points
    level, elsewhere = (float(np.sqrt(square[x].mean())) for x in (near, ~near))
    if before is None:
        return replace(turns, level=level, looser=max(FIRST_LOOSER, level / elsewhere))
    return replace(turns, level=before.level, looser=before.level / elsewhere)


def update_modes(inference: Inference) -> Inference | None:
    """The solution in its own modes, which move with masses and stiffnesses: damping of the whole, and coordinates.

    The next modes are those of the last solution. What parameters do to the modes is left out of the linearised
    equations: of the stiffness's part it is the damping ratio. None where they are the same.
    """
    problem = problem_in_own_modes(inference)
    return None if problem is None else _carried_to(inference, problem, inference.solver)


def problem_in_own_modes(inference: Inference) -> JointProblem | None:
    """The problem in the modes at a solution's parameters; None where they are those that it has."""
    before, problem = inference.problem.structure, _present(inference)
    moved = not shares_basis(problem.structure, before) or problem.structure.damping_change(before) > SAME_MODES
    return problem if moved else None


def place_knots(inference: Inference) -> Inference | None:
    """The solution with knots where its curves bend that nobody has a law for; None where that is no more probable."""
    first = inference.problem.first
    if first.priors or not _chooses_its_basis(inference):
        return None
    structure = bending_at(first.structure, inference.evidence.values(inference.trained.solution.point))
    if shares_basis(structure, first.structure):
        return None
    again = _carried_to(inference, inference.problem.in_basis_of(structure), inference.solver)
    return again if again is not None and _gains(again.trained, inference.trained) else None


def lower_discrepancy(inference: Inference) -> Inference | None:
    """The solution under a smaller discrepancy, where that is more probable once all levels follow; else None.

    What a curve could not follow has passed for one. Levels that make up for each other creep back from there.
    """
    evidence, before = inference.evidence, inference.trained
    if not (evidence.equations.curve >= 0).any():
        return None
    noise = before.noise.with_discrepancy(before.noise.discrepancy / SCAN_FACTOR)
    again = evidence.train(noise, before.solution.point)
    if again is None:
        return None
    again = inference.solver.settled(evidence, again)
    return replace(inference, trained=again) if _gains(again, before) else None


def _gains(after: Trained, before: Trained) -> bool:
    return after.log_evidence > before.log_evidence + NEGLIGIBLE_GAIN


def loosen_at_turning_points(inference: Inference) -> Inference | None:
    """The solution with a level of its own where contacts turn; None where what is left elsewhere falls no more."""
    before, problem = inference.problem.first.turning_points, with_turning_points(inference, _present(inference))
    settled = before is not None and inference.trained.noise.discrepancy > SAME_LEVEL * before.discrepancy
    if settled or problem.first.turning_points is None:
        return None
    return _carried_to(inference, problem, inference.solver)


def refine_features(inference: Inference) -> Inference | None:
    """The solution in finer features for the records that want them; None where none does, or they find none.

    Finer ones would reach further beyond the band, where forces that nobody measured are free. Of a model that explains
    nothing absurd parameters would ask for them.
    """
    if inference.problem.has_unknown_forces or not inference.explains_something:
        return None
    wanted = inference.evidence.each_record(knots_wanted, inference.trained)
    records = zip(inference.solver.designs, wanted, inference.problem, strict=True)
    designs = tuple(
        design.finer(factor, record_problem.record) or design if factor >= WORTHWHILE else design
        for design, factor, record_problem in records
    )
    if all(new is old for new, old in zip(designs, inference.solver.designs, strict=True)):
        return None
    problem, solver = with_turning_points(inference, _present(inference)), replace(inference.solver, designs=designs)
    again = _carried_to(inference, problem, solver)
    if again is None:
        return None
    unknown = again.evidence.equations.unknown
    before, after = (np.diag(one.trained.factor.corner_covariance)[unknown] for one in (inference, again))
    return replace(again, narrowed=float(np.sqrt(np.max(before / after, initial=0.0))))


def _present(inference: Inference) -> JointProblem:
    """The problem of a solution, with damping of the whole and coordinates in the modes of the structure there."""
    problem, values = inference.problem, inference.evidence.values(inference.trained.solution.point)
    is_exact = FACTOR not in values or is_exact_at(problem.structure, values[FACTOR], SAME_FACTORS)
    if not is_exact and _chooses_its_basis(inference):
        problem = problem.in_basis_of(reduced_at(problem.structure, values[FACTOR]))
    return problem.present(values)


def _chooses_its_basis(inference: Inference) -> bool:
    """A state that is handed over has its coordinates, and so have parameters that spectra or earlier records tell."""
    return not inference.is_informed and inference.problem.first.hand_over is None


def _carried_to(inference: Inference, problem: JointProblem, solver: Solver) -> Inference | None:
    """The same solution of a problem that is posed in another way; None where it cannot be solved."""
    evidence = solver.evidence(problem)
    levels, points = [], []
    before, now = zip(inference.by_record, inference.trained.noise.records, strict=True), evidence.equations
    for ((coarse, point), noise), fine in zip(before, now.by_record, strict=True):
        more = (fine.refinement / coarse.refinement) ** 0.5
        discrepancy, per_sample = more * noise.discrepancy, fine.refinement
        levels.append(replace(noise, discrepancy=discrepancy, points_per_sample=per_sample))
        points.append(carried_over(point, coarse, fine))
    carried_noise, point = replace(inference.trained.noise, records=tuple(levels)), now.joined(points)
    if now.uncertain or not problem.structure.has_linear_laws:
        point = softer_point(evidence, carried_noise, point)
    again = evidence.train(carried_noise, point)
    # About turns single steps of Gauss-Newton leave a little undone; what settles the levels goes on.
    if again is None or not (again.solution.converged or problem.first.turning_points is not None):
        return None
    again = solver.settled(evidence, again)
    # Finer features can only follow a sensor better.
    is_noisier = any(
        bool((new.response[quantity] > SUSPECT * level).any())
        for new, old in zip(again.noise.records, inference.trained.noise.records, strict=True)
        for quantity, level in old.response.items()
    )
    return None if is_noisier else replace(inference, evidence=evidence, trained=again, solver=solver)
