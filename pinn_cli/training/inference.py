"""From a problem to its most probable solution: discrepancy searched, noise levels settled, features fine enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from pinn_cli.network.base import NetworkDesign
from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.spline import Spline
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.parameters import FACTOR, ParameterVector
from pinn_cli.system.quantities import FORCE
from pinn_cli.training.base import built
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.history import History
from pinn_cli.training.inferred import InferenceSettings, Inferred
from pinn_cli.training.levels import settled
from pinn_cli.training.noise_model import NoiseLevels, NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.point import Point
from pinn_cli.training.starting_noise import starting_noise
from pinn_cli.training.steps.coloured import coloured, driven_in_band, has_forces
from pinn_cli.training.steps.discrepancy_search import DECISIVE_DROP, searched, widened_for_colour
from pinn_cli.training.steps.driving import reaches_beyond
from pinn_cli.training.steps.free_running import running_free
from pinn_cli.training.steps.marginal_peak import at_marginal_peak
from pinn_cli.training.steps.near_levels import near_known_levels, softer_point
from pinn_cli.training.steps.part_of_record import is_trustworthy, part_of_record, whole_from
from pinn_cli.training.steps.resolution import carried_over, knots_wanted
from pinn_cli.training.steps.rivals import Choice, weighed
from pinn_cli.training.steps.simulated_start import simulated_start
from pinn_cli.training.steps.turns import at_turns, has_turns
from pinn_cli.training.steps.windows_discrepancy import of_all_windows
from pinn_cli.training.whittle.whittle_estimate import known_parameters

# Steps at most under one noise model, and the relative decrease of the loss below which one has converged.
ITERATIONS, TOLERANCE = 12, 1e-6
# The same where a finished run says where the solution is: steps from there converge at once.
NEAR_TOLERANCE = 3e-5
# A discrepancy of this part of the force that acts explains nothing; then the sensors are taken to be so many times as
# noisy as their spectra say.
NOTHING_EXPLAINED, NOISIER = 0.3, (3.0, 10.0)
# Times that the features are made finer at most, and the factor on their number below which that is not worth it.
REFINEMENTS, WORTHWHILE = 2, 1.1
# Times that damping of the whole and reduced coordinates are taken to the modes of the last solution at most, and the
# relative change of damping's matrix below which they are the same: beside what else is uncertain of damping that is
# nothing. So is what coordinates that are exact at factors so far off leave out: 1e-4 of the motion.
MODE_ROUNDS, SAME_MODES, SAME_FACTORS = 3, 2e-3, 5e-3
# Rounds that tell turns of contacts from the rest at most, and the discrepancy over the last one at which they end.
TURN_ROUNDS, SAME_LEVEL = 6, 0.7
# Finer features whose sensors come out so many times as noisy have not found the solution.
SUSPECT = 2.0


def inferred(
    problem: Problem, design: NetworkDesign, settings: InferenceSettings, device: str, history: History
) -> Inferred:
    """The most probable readout and parameters under the most probable noise levels.

    Raises:
        DivergenceError: Even the softest physics cannot be solved.
    """
    if problem.prior is not None:  # what earlier records leave open is no belief of a user's
        settings = replace(settings, learn_spread=False, tolerance=max(settings.tolerance, NEAR_TOLERANCE))
    problem, settings = _of_spectra(problem, settings)
    if all(len(own.inputs.forces) == own.record.ndof for own in problem.by_record):
        # Forces that are free on every DOF follow any parameters: their spread would grow without end.
        settings = replace(settings, learn_spread=False)
    designs = [design] * len(problem.by_record)
    found = _best_start(problem, designs, settings, device, history)
    if has_forces(problem):
        found = _in_their_band(found, problem, designs, settings, device, history)
        found = coloured(found, settings, device, history)
    found = _in_present_modes(found, designs, settings, device, history)
    if has_turns(found.evidence.problem):
        found = _apart_from_turns(found, designs, settings, device, history)
    narrowed = 1.0
    # Finer features would reach further beyond the band, where forces that nobody measured are free.
    for _ in range(0 if has_forces(problem) else REFINEMENTS):
        finer = _finer(designs, found)
        again = None if finer is None else _refined(found, finer, settings, device, history)
        if finer is None or again is None:
            break
        narrowed = _narrowed(found, again)
        designs, found = finer, again
    found = _in_present_modes(found, designs, settings, device, history)
    evidence, settle = found.evidence, partial(settled, found.evidence, pooled=settings.pooled)
    told = settings.known is not None or problem.prior is not None  # by spectra, or by earlier records
    choice = Choice(found.trained) if told else weighed(evidence, found.trained, settle)
    trained, windows = choice.trained, None
    if _is_window(evidence):
        trained, windows = of_all_windows(evidence, trained)
    widened = driven_in_band(evidence, widened_for_colour(evidence, trained))
    widened = widened if told else at_marginal_peak(evidence, widened)
    # Where a force is free nothing tells it from what the model leaves out; windows and samplers go on from the first.
    told = told or problem.hand_over is not None or bool(problem.priors) or has_forces(problem)
    free = running_free(evidence, widened) if problem.identifies and not told else ()
    return Inferred(evidence, widened, choice.rivals, windows, narrowed, free)


def _narrowed(coarse: Inferred, fine: Inferred) -> float:
    """How many times as large the deviation of an unknown parameter was in coarser features; of all the most."""
    unknown = fine.evidence.equations.unknown
    before, after = (np.diag(found.trained.factor.corner_covariance)[unknown] for found in (coarse, fine))
    return float(np.sqrt(np.max(before / after, initial=0.0)))


def _is_window(evidence: Evidence) -> bool:
    """Whether windows before it say something of its discrepancy, or it does to those after it."""
    problem, known = evidence.problem, evidence.equations.each[0].known
    goes_on = problem.prior is not None and problem.prior.levels.told is not None
    return (problem.hand_over is not None or goes_on) and known is None and not has_forces(problem)


def _of_spectra(problem: Problem, settings: InferenceSettings) -> tuple[Problem, InferenceSettings]:
    """The problem and its settings, with parameters that the spectra of its sensors tell, where these tell them."""
    starts = (replace(problem, alternatives=()), *problem.alternatives)
    every = [(start, known_parameters(start, settings.learn_spread)) for start in starts]
    found = [(start, known) for start, known in every if known is not None and known.converged]
    if not found:
        return problem, settings
    best, known = max(found, key=lambda one: one[1].log_likelihood)
    vector = ParameterVector(best.structure.parameters_like(np.empty(0)), best.uncertain)
    best = best.present(vector.values(known.distance * vector.each("prior_std")))
    return best, replace(settings, known=known, learn_spread=False)


def _finer(designs: Sequence[NetworkDesign], found: Inferred) -> list[NetworkDesign] | None:
    """Designs with finer features for the records that want them; None where none does, or none can have them."""
    wanted = found.evidence.each_record(knots_wanted, found.trained)
    each = zip(designs, wanted, found.evidence.problem.by_record, strict=True)
    finer = [design.finer(factor, own.record) if factor >= WORTHWHILE else None for design, factor, own in each]
    if not any(finer):
        return None
    return [new or old for new, old in zip(finer, designs, strict=True)]


def inferred_sensor_noise(problem: Problem, device: str = "cpu") -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Noise of every response sensor and of every force sensor, each (n,), for estimators that infer none themselves.

    That of a spline's solution of the same problem; where there is none, what the spectra show.
    """
    settings, history = InferenceSettings(ITERATIONS, TOLERANCE, learn_spread=True, pooled=False), History(False)
    try:
        found = _best_start(replace(problem, alternatives=()), [Spline()], settings, device, history)
        noise = found.trained.noise.records[0]
    except DivergenceError:
        noise = starting_noise(NormalEquations(_built(Spline(), problem), problem, device))
    return noise.response, noise.response.get(FORCE, noise.force[: problem.dynamics.ndof])


def _best_start(
    problem: Problem, designs: Sequence[NetworkDesign], settings: InferenceSettings, device: str, history: History
) -> Inferred:
    """The most probable of the solutions from every start of the unknown parameters.

    Raises:
        DivergenceError: None could be solved.
    """
    through_part = _through_part(problem, designs, settings, device, history)
    if through_part is not None:
        return through_part
    solutions: list[Inferred] = []
    failure: DivergenceError | None = None
    for start in (problem, *problem.alternatives):
        networks = [_built(design, own) for design, own in zip(designs, start.by_record, strict=True)]
        evidence = settings.solved_by(start, networks, device, history)
        noise = _starting_noise(evidence, settings)
        try:
            trained = near_known_levels(evidence, noise) or _searched(evidence, noise)
        except DivergenceError as error:
            failure = error
            continue
        solutions.append(Inferred(evidence, settled(evidence, trained, settings.pooled)))
    if not solutions:
        raise failure or DivergenceError("there is no start")
    return max(solutions, key=lambda found: found.trained.log_evidence)


def _through_part(
    problem: Problem, designs: Sequence[NetworkDesign], settings: InferenceSettings, device: str, history: History
) -> Inferred | None:
    """The most probable solution, from a search in a part of the record; None where that would not do."""
    found: list[tuple[Problem, LinearReadout, Evidence, float, Trained]] = []
    for start in () if settings.known is not None else (problem, *problem.alternatives):
        network = _built(designs[0], start)
        part = part_of_record(start, network)
        if part is None:
            return None
        own, shorter = part
        evidence = settings.solved_by(own, [shorter], device, history)
        noise = _starting_noise(evidence, settings)
        try:
            trained = _searched(evidence, noise)
        except DivergenceError:
            continue
        if is_trustworthy(trained, noise.discrepancy):
            found.append((start, network, evidence, noise.discrepancy, trained))
    best = max((trained.log_evidence for *_, trained in found), default=0.0)
    solutions = []
    for start, network, of_part, largest, trained in found:
        if trained.log_evidence < best - DECISIVE_DROP:
            continue
        evidence = settings.solved_by(start, [network], device, history)
        try:
            whole = whole_from(trained, of_part, largest, evidence, _starting_noise(evidence, settings))
        except DivergenceError:
            return None
        if whole is None:
            return None
        solutions.append(Inferred(evidence, settled(evidence, whole, settings.pooled)))
    return max(solutions, key=lambda one: one.trained.log_evidence, default=None)


def _starting_noise(evidence: Evidence, settings: InferenceSettings) -> NoiseLevels:
    noise = NoiseLevels(tuple(map(starting_noise, evidence.equations.each)))
    noise = noise.each(NoiseModel.pooled) if settings.pooled else noise
    return noise if settings.known is None else replace(noise, spread=settings.known.spread)


def _searched(evidence: Evidence, noise: NoiseLevels) -> Trained:
    """The most probable discrepancy, under noisier sensors too where the model explains nothing under these.

    Raises:
        DivergenceError: Even the softest physics cannot be solved.
    """
    second = partial(_simulated_start, evidence)
    best = searched(evidence, noise, noise.discrepancy, second)
    for factor in NOISIER:
        if best.solution.converged and best.noise.discrepancy < NOTHING_EXPLAINED * noise.discrepancy:
            break
        try:
            noisier = noise.each(NoiseModel.noisier, factor)
            again = searched(evidence, noisier, noise.discrepancy, second)
        except DivergenceError:
            break
        best = max(best, again, key=lambda trained: (trained.solution.converged, trained.log_evidence))
    return best


def _simulated_start(evidence: Evidence) -> Point | None:
    """See :func:`simulated_start`; None where there is none of any record."""
    points = [simulated_start(own) for own in evidence.equations.each]
    return evidence.equations.joined(points) if all(points) else None  # type: ignore[arg-type]


def _in_their_band(
    found: Inferred,
    problem: Problem,
    designs: Sequence[NetworkDesign],
    settings: InferenceSettings,
    device: str,
    history: History,
) -> Inferred:
    """The solution with unknown forces that reach as far as they do; see :func:`reaches_beyond`."""
    factors = found.evidence.each_record(reaches_beyond, found.trained)
    each = zip(designs, factors, problem.by_record, strict=True)
    wider = [design.finer(factor, own.record) for design, factor, own in each]
    if max(factors) <= 1.0 or not all(wider):
        return found

    def widened(one: Problem) -> Problem:
        own = [_of_wider_band(own, factor) for own, factor in zip(one.by_record, factors, strict=True)]
        return replace(Problem.together(own), alternatives=tuple(map(widened, one.alternatives)))

    return _best_start(widened(problem), [one for one in wider if one], settings, device, history)


def _of_wider_band(problem: Problem, factor: float) -> Problem:
    inputs = problem.inputs
    wider = replace(inputs, edge=inputs.edge * factor, correlation_time=inputs.correlation_time / factor)
    return replace(problem, inputs=wider)


def _in_present_modes(
    found: Inferred, designs: Sequence[NetworkDesign], settings: InferenceSettings, device: str, history: History
) -> Inferred:
    """The solution in its own modes, which move with masses and stiffnesses: damping of the whole, and coordinates.

    The next modes are those of the last solution. What parameters do to the modes is left out of the linearised
    equations: of the stiffness's part it is the damping ratio.
    """
    for _ in range(MODE_ROUNDS):
        before, now = found.evidence.problem.structure, _present(found).structure
        moved = now.shapes is not before.shapes or now.damping_apart(before) > SAME_MODES
        again = _refined(found, designs, settings, device, history) if moved else None
        if again is None:
            break
        found = again
    return found


def _apart_from_turns(
    found: Inferred, designs: Sequence[NetworkDesign], settings: InferenceSettings, device: str, history: History
) -> Inferred:
    """The solution with a level of its own where contacts turn: what is left elsewhere then falls, round by round."""
    for _ in range(TURN_ROUNDS):
        again = _refined(found, designs, settings, device, history)
        if again is None:
            break
        before, found = found, again
        if found.trained.noise.discrepancy > SAME_LEVEL * before.trained.noise.discrepancy:
            break
    return found


def _present(found: Inferred) -> Problem:
    """The problem of a solution, with damping of the whole and coordinates in the modes of the structure there."""
    equations, point = found.by_record[0]
    problem, values = found.evidence.problem, {k: x.cpu().numpy() for k, x in equations.parameters(point).items()}
    # A state that is handed over has its coordinates, and so have parameters that spectra have told.
    free = problem.prior is None and problem.hand_over is None and equations.known is None
    if free and FACTOR in values and not problem.structure.is_exact_at(values[FACTOR], SAME_FACTORS):
        problem = problem.reduced_at(values[FACTOR])
    return problem.present(values)


def _refined(
    found: Inferred, designs: Sequence[NetworkDesign], settings: InferenceSettings, device: str, history: History
) -> Inferred | None:
    """The same solution in finer features; None where they cannot be solved."""
    problem = at_turns(found, replace(_present(found), alternatives=()))
    networks = [_built(design, own) for design, own in zip(designs, problem.by_record, strict=True)]
    evidence = settings.solved_by(problem, networks, device, history)
    levels, points = [], []
    before, now = zip(found.by_record, found.trained.noise.records, strict=True), evidence.equations
    for ((coarse, point), noise), fine in zip(before, now.each, strict=True):
        more = (fine.refinement / coarse.refinement) ** 0.5
        discrepancy, per_sample = more * noise.discrepancy, fine.refinement
        levels.append(replace(noise, discrepancy=discrepancy, points_per_sample=per_sample))
        points.append(carried_over(point, coarse, fine))
    every, point = replace(found.trained.noise, records=tuple(levels)), now.joined(points)
    if problem.structure.nonlinearity_name != "linear" or now.uncertain:
        point = softer_point(evidence, every, point)
    again = evidence.train(every, point)
    # About turns single steps of Gauss-Newton leave a little undone; what settles the levels goes on.
    if again is None or not (again.solution.converged or problem.turns is not None):
        return None
    again = settled(evidence, again, settings.pooled)
    return None if _is_noisier(again.noise, found.trained.noise) else Inferred(evidence, again)


def _is_noisier(fine: NoiseLevels, coarse: NoiseLevels) -> bool:
    """Whether any response sensor is far noisier in finer features, which can only follow it better."""
    return any(
        bool((new.response[quantity] > SUSPECT * level).any())
        for new, old in zip(fine.records, coarse.records, strict=True)
        for quantity, level in old.response.items()
    )


def _built(design: NetworkDesign, problem: Problem) -> LinearReadout:
    network = built(design, problem)
    assert isinstance(network, LinearReadout)
    return network
