"""The first solution of a problem: its noise levels and parameters found from soft physics to stiff."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import chain

import numpy as np
import torch

from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.spline import Spline
from pinn_cli.record.free_run import NoFreeRunError, free_run
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.parameters import ParameterVector
from pinn_cli.system.quantities import FORCE
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.history import History
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import FeatureProjection, NoiseLevels, NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.solver import Inference, Solver
from pinn_cli.training.steps.discrepancy_search import NothingNew, Path, holds, leaves_less_than, searched
from pinn_cli.training.steps.known_levels import solve_under_known_levels
from pinn_cli.training.steps.part_of_record import part_of_record, whole_from
from pinn_cli.training.whittle.whittle_estimate import known_parameters


def simulated_start(equations: NormalEquations) -> Point | None:
    """The prescribed chain's motion from rest under the measured force, as readout weights.

    None where it cannot be had: a force is unknown, a parameter is, the motion does not stay finite, or velocity is an
    output of its own.
    """
    problem = equations.problem
    if problem.identifies or equations.network.channels > 1:
        return None
    try:
        motion = free_run(problem.structure, problem.record)
    except NoFreeRunError:
        return None
    coordinates = motion.displacement if motion.coordinates is None else motion.coordinates[:, 0]
    supports = None if motion.supports is None else motion.supports[:, 0]
    functions = [coordinates, *(x for x in (motion.hidden, supports, motion.ground_acceleration) if x is not None)]
    histories = np.column_stack([*functions, problem.record.force[:, list(problem.inputs.loads)]])
    projection = FeatureProjection(equations.network, equations.observation)
    like = equations.target.force
    weights = projection.coefficients(torch.as_tensor(histories).to(like))
    return Point(equations.layout.unknowns(weights.to(like)), equations.start().parameters)


# A discrepancy of this part of the force that acts explains nothing, or the search went astray; then the sensors are
# taken to be so many times as noisy as their spectra say.
NOTHING_EXPLAINED, NOISIER = 0.3, (3.0, 10.0)


def identify_by_spectra(problem: JointProblem, solver: Solver) -> tuple[JointProblem, Solver]:
    """The problem and its solver, with the parameters that the spectra of its sensors tell, where these tell them."""
    learn_spread = solver.learn_spread and not problem.is_informed
    starts = [(start, known_parameters(start, learn_spread)) for start in problem.starts]
    solved = [(start, parameters) for start, parameters in starts if parameters is not None and parameters.converged]
    if not solved:
        return problem, solver
    best, parameters = max(solved, key=lambda pair: pair[1].log_likelihood)
    vector = ParameterVector(best.structure.parameters_like(np.empty(0)), best.alone.uncertain)
    best = best.present(vector.values(parameters.distance * vector.each("prior_std")))
    return best, replace(solver, known_parameters=parameters, learn_spread=False)


def first_solution(problem: JointProblem, solver: Solver) -> Inference:
    """The most probable solution from the starts of the unknown parameters, under its own noise levels.

    A long record is searched in a part of it first.

    Raises:
        DivergenceError: None could be solved.
    """
    (network, *_), (start, *_) = solver.networks(problem), problem.starts
    part = None if solver.known_parameters is not None else part_of_record(start, network)
    inference = None
    if part is not None:
        inference = _through_a_part(problem, solver, network, part)
        problem = replace(problem, elsewhere=tuple)  # what lies there has been looked for
    inference = inference or _from_the_starts(problem, solver)[0]
    return replace(inference, trained=solver.settled(inference.evidence, _held(inference)))


def _held(inference: Inference) -> Trained:
    """The solution, whose parameters stay where they are if forces are unknown that would follow them anywhere.

    Together with the most probable of these forces, and their levels, parameters run away. What is integrated out moves
    them: see :mod:`pinn_cli.training.steps.marginal_likelihood`. Those of which something is believed begin there, and
    where they have run so far that a hysteresis creates energy, all begin at their start.
    """
    trained, evidence, point = inference.trained, inference.evidence, inference.trained.solution.point
    if not inference.problem.has_unknown_forces or inference.is_informed:
        return trained
    is_start = torch.as_tensor(~evidence.equations.unknown)
    if evidence.creates_energy(point):
        is_start = torch.ones_like(is_start)
    believed = replace(point, parameters=torch.where(is_start, 0.0, point.parameters))
    return evidence.train(replace(trained.noise, held=True), believed) or trained


def _through_a_part(
    problem: JointProblem, solver: Solver, network: LinearReadout, part: tuple[Problem, LinearReadout]
) -> Inference | None:
    """The solution next to that of a part of the record; None where it is not a good model."""
    part_problem, shorter = part
    in_part = problem.changed(partial(replace, record=part_problem.record))
    try:
        of_part, largest = _from_the_starts(in_part, solver, [shorter])
        if not holds(of_part.trained, largest):
            return None
        of_whole = of_part.problem.changed(partial(replace, record=problem.alone.record))
        evidence = solver.evidence(of_whole, [network])
        whole = whole_from(of_part.trained, of_part.evidence, largest, evidence, solver.starting_noise(evidence))
    except DivergenceError:
        return None
    return None if whole is None else Inference(evidence, whole, solver)


def _from_the_starts(
    problem: JointProblem, solver: Solver, networks: Sequence[LinearReadout] | None = None
) -> tuple[Inference, float]:
    """Of the solutions from all starts, up to the first whose model holds, the most probable one, and the force, N.

    Those that come as near to the spectra as the first are all compared: of two displacements with 15 dB of noise one
    with a spring 89 % off explained the record, and the truth was exp(72) times as probable. Where no model holds, one
    from starts elsewhere whose model does, if there is one that is more probable.

    Raises:
        DivergenceError: None could be solved.
    """
    paths: list[Path] = []
    failures: list[DivergenceError] = []
    solve, solutions = partial(_solution, solver, networks, paths, failures), list[tuple[Inference, float]]()
    for number, start in enumerate(problem.starts, 1):
        solutions += filter(None, [solve(start)])
        if number >= problem.compared and any(map(_holds, solutions)):
            break
    if not solutions:
        raise failures[-1] if failures else DivergenceError("there is no start")
    best = max(solutions, key=_log_density)
    if not _holds(best):
        # Of models that do not hold the one that follows the sensors most would be taken.
        elsewhere = filter(None, map(solve, problem.elsewhere()))
        best = max(chain([best], filter(_holds, elsewhere)), key=_log_density)
    return best


def _solution(
    solver: Solver,
    networks: Sequence[LinearReadout] | None,
    paths: list[Path],
    failures: list[DivergenceError],
    start: JointProblem,
) -> tuple[Inference, float] | None:
    """That from one start, and the force that acts, N; None where it leads to nothing new beside earlier ones' paths.

    Or where nothing could be solved; then it is one failure more.
    """
    evidence, path = solver.evidence(start, networks), Path(paths)
    noise = solver.starting_noise(evidence)
    try:
        trained = solve_under_known_levels(evidence, noise) or soft_to_stiff(evidence, noise, path)
    except NothingNew:
        return None
    except DivergenceError as error:
        failures.append(error)
        return None
    paths.append(path)
    return Inference(evidence, trained, solver), noise.discrepancy


def _holds(solution: tuple[Inference, float]) -> bool:
    return holds(solution[0].trained, solution[1])


def _log_density(solution: tuple[Inference, float]) -> float:
    """Of the record and the parameters, which each start counts in its own scales: their volumes do not compare."""
    trained = solution[0].trained
    return trained.log_evidence + 0.5 * trained.factor.parameter_log_determinant


def soft_to_stiff(evidence: Evidence, noise: NoiseLevels, path: Path) -> Trained:
    """The most probable discrepancy, under noisier sensors too where the model explains nothing under these.

    Not where these have led nowhere from an earlier start.

    Raises:
        NothingNew: See :func:`searched`.
        DivergenceError: Even the softest physics cannot be solved.
    """
    second = partial(_simulated_start, evidence)
    best = searched(evidence, noise, second, path)
    # What is wrong for all starts alike is the model, or a sensor.
    for factor in () if any(earlier.leads_nowhere for earlier in path.earlier) else NOISIER:
        if leaves_less_than(best, NOTHING_EXPLAINED * noise.discrepancy):
            break
        try:
            again = searched(evidence, noise.each(NoiseModel.noisier, factor), second)
        except DivergenceError:
            break
        # Noisier sensors show the way, but are less probable wherever it leads.
        told = evidence.train(again.noise.each(NoiseModel.noisier, 1.0 / factor), again.solution.point)
        found = filter(None, (best, again, told))
        best = max(found, key=lambda trained: (trained.solution.converged, trained.log_evidence))
    path.leads_nowhere = not leaves_less_than(best, NOTHING_EXPLAINED * noise.discrepancy)
    return best


def _simulated_start(evidence: Evidence) -> Point | None:
    """See :func:`simulated_start`; None where there is none of any record."""
    points = [simulated_start(equations) for equations in evidence.equations.by_record]
    return evidence.equations.joined(points) if all(points) else None  # type: ignore[arg-type]


def inferred_sensor_noise(problem: Problem) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Noise of every response sensor and of every force sensor, each (n,), for estimators that infer none themselves.

    That of a spline's solution of the same problem; where there is none, what the spectra show.
    """
    solver, start = Solver((Spline(),), History(False)), JointProblem.of(problem)
    try:
        noise = first_solution(start, solver).trained.noise.records[0]
    except DivergenceError:
        noise = solver.starting_noise(solver.evidence(start)).records[0]
    return noise.response, noise.response.get(FORCE, noise.force[: problem.dynamics.ndof])
