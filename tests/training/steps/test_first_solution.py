"""The first solution: where else it is looked for, in a part of a long record, from a simulated motion."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from one_record import by_spline, evidence_of, levels_of, shown_noise
from small_problems import QUANTITIES, accelerations, measured, small_chain

from pinn_cli.network.fourier import Fourier
from pinn_cli.network.spline import Spline
from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.free_run import NoFreeRunError, free_run
from pinn_cli.record.record import Measurements, Record
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation
from pinn_cli.report.fitness import fitness_percent
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.history import History
from pinn_cli.training.inference import infer
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseLevels
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.solver import Inference, Solver
from pinn_cli.training.steps import discrepancy_search as search
from pinn_cli.training.steps import first_solution as module
from pinn_cli.training.steps import part_of_record
from pinn_cli.training.steps.discrepancy_search import scanned, searched
from pinn_cli.training.steps.first_solution import simulated_start

UNKNOWN = Parameter("k", 0, 12.0, 120.0, unknown=True)


def of_an_unknown_spring(law: str) -> Problem:
    made = small_chain(law)
    record = accelerations(measured(made, snr_db=40.0, duration=20.0, samples=400).record, (1, 2, 3))
    return Problem(made.with_values({UNKNOWN: 12.0}), record, (UNKNOWN,))


@pytest.fixture(scope="module")
def problem() -> Problem:
    return of_an_unknown_spring("linear")


def solver() -> Solver:
    return Solver((Spline(),), History(False))


def solved(problem: JointProblem) -> Inference:
    return module.first_solution(problem, solver())


def starting(problem: Problem) -> tuple[Evidence, NoiseLevels]:
    evidence = solver().evidence(JointProblem.of(problem))
    return evidence, solver().starting_noise(evidence)


def scanned_from_rest(evidence: Evidence, noise: NoiseLevels) -> Trained:
    return scanned(evidence, noise, noise.discrepancy, evidence.equations.start())


def heavier(problem: Problem) -> Problem:
    """One whose model is wrong, wherever it starts."""
    structure = problem.structure.with_parameters(m=4.0 * problem.structure.parameters["m"])
    return replace(problem, structure=structure, uncertain=(replace(UNKNOWN, prior_std=1e-3),))


def test_a_model_that_holds_is_looked_for_nowhere_else(problem):
    asked = []
    found = solved(JointProblem((problem,), elsewhere=lambda: asked.append(1) or ()))
    assert not asked
    (moved,) = found.trained.solution.point.parameters.numpy() * found.evidence.equations.scale
    assert moved == pytest.approx(3.0, rel=0.02)


def test_one_that_does_not_is_looked_for_elsewhere_and_the_more_probable_one_kept(problem):
    wrong, right = JointProblem.of(heavier(problem)), JointProblem.of(problem)
    alone, found = solved(wrong), solved(replace(wrong, elsewhere=lambda: (right,)))
    assert found.trained.log_evidence > alone.trained.log_evidence + 100.0
    assert found.problem.alone.structure is problem.structure
    another = replace(wrong, elsewhere=lambda: (JointProblem.of(heavier(heavier(problem))),))
    assert solved(another).problem.alone is wrong.alone  # which does not hold either


@pytest.mark.parametrize("compared", [1, 2])
def test_of_starts_that_come_as_near_the_most_probable_is_taken(problem, compared, monkeypatch):
    """A wrong structure's model may hold as well."""
    masses = 1.003 * problem.structure.parameters["m"]
    nearly = replace(problem, structure=problem.structure.with_parameters(m=masses))
    found = [module._solution(solver(), None, [], [], JointProblem.of(one)) for one in (nearly, problem)]
    monkeypatch.setattr(module, "_solution", lambda *given: found[given[-1].alone is problem])
    joint = JointProblem((nearly,), (JointProblem.of(problem),), compared=compared)
    assert solved(joint).problem.alone is (nearly, problem)[compared - 1]


def test_a_start_that_cannot_be_solved_costs_none_of_the_others(problem, monkeypatch):
    broken = JointProblem.of(replace(problem, record=problem.record.until(60)))
    searched = module.soft_to_stiff

    def refused(evidence, noise, path):
        if evidence.problem.alone.record is broken.alone.record:
            raise DivergenceError("singular")
        return searched(evidence, noise, path)

    monkeypatch.setattr(module, "soft_to_stiff", refused)
    found = solved(replace(broken, other_starts=(JointProblem.of(problem),)))
    assert found.problem.alone is problem
    wrong = JointProblem.of(heavier(problem))
    assert solved(replace(wrong, elsewhere=lambda: (broken,))).problem.alone is wrong.alone
    with pytest.raises(DivergenceError, match="singular"):
        solved(broken)


def test_where_noisier_sensors_show_the_way_their_own_noise_judges_where_it_leads(monkeypatch):
    evidence, noise = searching()

    def strays(evidence, levels, *given):
        found = searched(evidence, levels, *given)
        own = levels.records[0].response["acceleration"] is noise.records[0].response["acceleration"]
        return replace(found, solution=replace(found.solution, converged=False)) if own else found

    monkeypatch.setattr(module, "searched", strays)
    found = module.soft_to_stiff(evidence, noise, search.Path(()))
    assert found.solution.converged
    their_own, there = (levels.records[0].response["acceleration"] for levels in (noise, found.noise))
    np.testing.assert_allclose(there, their_own)


def test_where_noisier_sensors_lead_nowhere_they_are_not_asked_from_another_start(monkeypatch):
    (evidence, noise), asked = searching(), []

    def nothing(evidence, levels, *given):
        asked.append(levels.records[0].response["acceleration"][0] / noise.records[0].response["acceleration"][0])
        return evidence.train(levels, evidence.equations.start())

    monkeypatch.setattr(module, "searched", nothing)
    first = search.Path(())
    module.soft_to_stiff(evidence, noise, first)
    assert first.leads_nowhere
    module.soft_to_stiff(evidence, noise, search.Path((first,)))
    np.testing.assert_allclose(asked, [1.0, 3.0, 10.0, 1.0])


def test_a_start_that_comes_to_the_solution_of_another_is_not_followed_to_the_end(problem, monkeypatch):
    asked: list[JointProblem] = []
    train = Evidence.train

    def counted(evidence, *given, **settings):
        asked.append(evidence.problem)
        return train(evidence, *given, **settings)

    monkeypatch.setattr(Evidence, "train", counted)
    first = JointProblem.of(problem)
    other, structure = replace(UNKNOWN, prescribed=13.0), problem.structure.with_values({UNKNOWN: 13.0})
    like = JointProblem.of(replace(problem, structure=structure, uncertain=(other,)))
    alone = solved(first)
    once = len(asked)
    asked.clear()
    solved(replace(first, other_starts=(like,)))
    assert len(asked) == once  # the model holds: no other start is tried
    monkeypatch.setattr(module, "_holds", lambda solution: False)
    asked.clear()
    found = solved(replace(first, other_starts=(like,)))
    assert found.problem.alone is problem
    assert found.trained.log_evidence == alone.trained.log_evidence
    assert len(asked) == once + 1
    # Where the other one is another solution, both are followed.
    asked.clear()
    solved(replace(first, other_starts=(JointProblem.of(heavier(problem)),)))
    assert len(asked) > once + 1


SAMPLES, DURATION = 1500, 72.0
UNCERTAIN = (
    Parameter("k", 0, 12.0, 120.0, unknown=True),
    Parameter("k", 1, 15.0, 1.125),
    Parameter("c", 2, 1.0, 0.075),
)


@pytest.fixture(scope="module")
def long_problem() -> Problem:
    record = measured(small_chain("linear"), snr_db=40.0, duration=DURATION, samples=SAMPLES).record
    return Problem(small_chain("linear"), accelerations(record, (1, 2, 3)), UNCERTAIN)


def inferred(long_problem: Problem) -> Inference:
    return infer(JointProblem.of(long_problem), solver())


def in_parts(monkeypatch, samples: int = 400) -> None:
    monkeypatch.setattr(part_of_record, "FEWEST_SAMPLES", samples)


def test_it_ends_where_a_search_in_all_of_the_record_ends(long_problem, monkeypatch):
    whole = inferred(long_problem)
    in_parts(monkeypatch)
    searched = []
    for place in (search, part_of_record):
        scan = place.scanned
        noted = lambda own, *a, scan=scan, **k: searched.append(own.problem.alone.record) or scan(own, *a, **k)  # noqa: E731
        monkeypatch.setattr(place, "scanned", noted)
    found = inferred(long_problem)
    assert len(searched) == 2
    assert len(searched[0].time) < 500
    factor, other = whole.trained.factor, found.trained.factor
    std, other_std = (np.sqrt(np.diag(x.corner_covariance)) for x in (factor, other))
    np.testing.assert_allclose(other_std, std, rtol=0.05)
    apart = found.trained.solution.point.parameters - whole.trained.solution.point.parameters
    assert np.all(np.abs(apart.numpy()) < 0.1 * std)
    (noise,), (again,) = whole.trained.noise.records, found.trained.noise.records
    np.testing.assert_allclose(again.response["acceleration"], noise.response["acceleration"], rtol=0.05)
    assert found.trained.log_evidence == pytest.approx(whole.trained.log_evidence, abs=1.0)


def test_the_part_has_the_same_knots_and_whole_samples(long_problem, monkeypatch):
    in_parts(monkeypatch)
    network = Spline().build(long_problem.record)
    own, fewer = part_of_record.part_of_record(JointProblem.of(long_problem), network)
    assert fewer.spacing == pytest.approx(network.spacing)
    assert fewer.start == network.start
    samples = len(own.record.time)
    assert 400 <= samples < 500
    np.testing.assert_array_equal(own.record.acceleration, long_problem.record.acceleration[:samples])
    # Behind the last sample the part ends as far as the whole does, but for what the whole's last interval has over.
    over = network.stop - long_problem.record.time[-1]
    assert 0.0 < fewer.stop - own.record.time[-1] <= over + 1e-9


def shaken_later(record: Record) -> Record:
    return replace(record, force=record.force * np.where(np.arange(SAMPLES) < 400, 0.1, 1.0)[:, None])


def test_some_records_are_searched_whole(long_problem, monkeypatch):
    """Of ordinary length, shaken later or too short, of other structures, or several of them."""

    def part(*problems: Problem):
        return part_of_record.part_of_record(JointProblem.of(*problems), Spline().build(problems[0].record))

    assert part(long_problem) is None
    in_parts(monkeypatch)
    for changed in (shaken_later(long_problem.record), long_problem.record.until(900)):
        assert part(replace(long_problem, record=changed)) is None
    assert part(replace(long_problem, structure=small_chain("duffing"))) is None
    assert part(long_problem, replace(long_problem)) is None


@pytest.mark.slow
def test_where_part_and_whole_have_little_in_common_all_of_it_is_searched(long_problem, monkeypatch):
    whole = inferred(long_problem)
    in_parts(monkeypatch)
    monkeypatch.setattr(part_of_record, "NEAR_STEPS", -1.0)
    found = inferred(long_problem)
    np.testing.assert_array_equal(found.trained.solution.point.parameters, whole.trained.solution.point.parameters)


def equations(record: Record, structure: Structure, uncertain=(), design=None) -> NormalEquations:
    return NormalEquations((design or Spline()).build(record), Problem(structure, record, uncertain))


@pytest.mark.parametrize("design", [Spline(), Fourier()], ids=["spline", "fourier"])
@pytest.mark.parametrize("hold", ["exact", "zero_order"])
def test_it_is_the_motion_of_the_prescribed_chain_from_rest(hold, design):
    measurements = measured(small_chain(), hold)
    found = equations(measurements.record.keep({"acceleration": (1,)}), small_chain(), design=design)
    point = simulated_start(found)
    motion = found.flat_states(found.observation, point)
    for quantity in ("displacement", "velocity"):
        truth = getattr(measurements.truth.response, quantity)
        # A network follows the motion as well as its features do: a few thousandths.
        np.testing.assert_allclose(getattr(motion, quantity), truth, atol=0.01 * np.abs(truth).max())


def test_there_is_none_where_the_motion_cannot_be_simulated():
    """A force or a parameter is unknown, velocities are outputs of their own, springs push, or are too stiff."""
    structure, record = small_chain(), measured(small_chain()).record
    force = record.force.copy()
    force[:, 1] = np.nan
    pushing = small_chain("linear")
    pushing = pushing.with_parameters(k=-5e3 * pushing.parameters["k"])
    driven = measured(small_chain("linear")).record
    with pytest.raises(NoFreeRunError, match="unstable"):
        free_run(pushing, driven)
    for none in (
        equations(replace(record, force=force, unforced=np.array([False, False, True])), structure),
        equations(record, structure, (Parameter("k", 1, 3.0, 100.0, unknown=True),)),
        equations(record, structure, design=Spline(continuity="penalised")),
        equations(driven, pushing),
        equations(record, small_chain(k=1e9)),
    ):
        assert simulated_start(none) is None


def searching() -> tuple[Evidence, NoiseLevels]:
    record = measured(small_chain(), snr_db=40.0).record
    return evidence_of(equations(record, small_chain())), levels_of(shown_noise(record, 1.0, 1.0))


def test_a_search_that_finds_a_good_model_asks_for_no_second_start():
    evidence, noise = searching()

    def never() -> None:
        raise AssertionError("a second start was asked for")

    searched(evidence, noise, never)


def test_without_a_second_start_the_first_one_stands(monkeypatch):
    evidence, noise = searching()
    monkeypatch.setattr("pinn_cli.training.steps.discrepancy_search.SUSPICIOUS_DISCREPANCY", 0.0)
    asked = []
    first = searched(evidence, noise, lambda: asked.append(None))
    assert len(asked) == 1
    assert first.log_evidence == scanned(evidence, noise, 1.0, evidence.equations.start()).log_evidence


def test_parameters_are_held_where_soft_physics_leads_them_astray(monkeypatch):
    evidence, noise = starting(of_an_unknown_spring("duffing"))
    train, asked = evidence.train, []
    astray = lambda trained: replace(trained, solution=replace(trained.solution, factorisations=40))  # noqa: E731

    def winding(levels: NoiseLevels, start: Point) -> Trained | None:
        asked.append(levels)
        return astray(train(levels, start)) if len(asked) == 1 else train(levels, start)

    monkeypatch.setattr(evidence, "train", winding)
    found = scanned_from_rest(evidence, noise)
    freely, *held = [levels.firmness for levels in asked]
    assert freely == 0.0
    assert held == sorted(held, reverse=True)
    assert held[0] > 50.0
    assert found.noise.firmness == 0.0
    monkeypatch.undo()
    expected = scanned_from_rest(evidence, noise)
    assert found.log_evidence == pytest.approx(expected.log_evidence, abs=0.1)


def test_a_scan_goes_on_where_a_solution_runs_into_its_limit(problem, monkeypatch):
    """It ended there, at physics so soft that nothing was told: a hysteresis came out 40 % off."""
    evidence, noise = starting(problem)
    train, asked = evidence.train, []
    limited = lambda trained: replace(trained, solution=replace(trained.solution, converged=False))  # noqa: E731
    expected = scanned_from_rest(evidence, noise)

    def creeping(levels: NoiseLevels, start: Point) -> Trained | None:
        asked.append(levels.discrepancy)
        return limited(train(levels, start)) if len(asked) == 2 else train(levels, start)

    monkeypatch.setattr(evidence, "train", creeping)
    found = scanned_from_rest(evidence, noise)
    assert asked[1] == asked[2]
    assert found.log_evidence == pytest.approx(expected.log_evidence, abs=0.1)


@pytest.mark.parametrize("firmness", [0.0, 30.0])
def test_the_prior_of_what_is_held_is_a_density(problem, firmness):
    """A parameter that the record says nothing of costs and gains no evidence, however firmly it is held."""
    nothing = Parameter("c", 0, 1.0, 1e-9, unknown=True)
    terms = []
    for uncertain in ((UNKNOWN,), (UNKNOWN, nothing)):
        evidence, noise = starting(replace(problem, uncertain=uncertain))
        trained = evidence.train(replace(noise, firmness=firmness), evidence.equations.start())
        assert trained is not None
        terms.append(trained.log_evidence)
    assert terms[1] == pytest.approx(terms[0], abs=1e-3)


@pytest.mark.slow
def test_of_two_the_more_probable_one_is_taken(monkeypatch):
    """A second start of nonsense does no harm."""
    evidence, noise = searching()
    expected = scanned(evidence, noise, 1.0, evidence.equations.start())
    monkeypatch.setattr("pinn_cli.training.steps.discrepancy_search.SUSPICIOUS_DISCREPANCY", 1e-9)
    rest = evidence.equations.start()
    wild = replace(rest, unknowns=torch.linspace(-50.0, 50.0, len(rest.unknowns), dtype=torch.float64))
    found = searched(evidence, noise, lambda: wild)
    assert found.log_evidence >= expected.log_evidence


STRONG = build_chain(6, Duffing(), m=10.0, c=1.0, k=15.0, kappa=5000.0)


def strongly_nonlinear() -> Measurements:
    """Springs whose cubic part carries most: one accelerometer on six DOFs."""
    force = BandedNoise(6, 20.0, 513, [0.05, 1.0], 5.0, [1])
    return Simulated(force, Simulation(20.0, 513), Noise(50.0)).measure(STRONG)


def recovered(measurements: Measurements) -> Estimate:
    scheme = SparseRecovery(unobserved=[2, 3, 4, 5, 6])
    problem = scheme.pose(STRONG, [scheme.observe(measurements.record)])
    return by_spline(problem)


def worst_fitness(estimate: Estimate, measurements: Measurements) -> float:
    truth = measurements.truth.response
    return min(fitness_percent(getattr(estimate.response, q), getattr(truth, q)).min() for q in QUANTITIES)


@pytest.mark.slow
def test_a_strongly_nonlinear_chain_needs_it(monkeypatch):
    measurements = strongly_nonlinear()
    found = recovered(measurements)
    assert worst_fitness(found, measurements) > 97.0
    monkeypatch.setattr(module, "simulated_start", lambda equations: None)
    alone = recovered(measurements)
    assert worst_fitness(alone, measurements) < 50.0
    assert alone.summary["log_evidence"] < found.summary["log_evidence"] - 100.0
