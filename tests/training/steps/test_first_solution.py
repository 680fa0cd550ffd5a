"""The first solution is looked for elsewhere where its model does not hold, and only there."""

from dataclasses import replace

import pytest
from small_problems import accelerations, measured, small_chain

from pinn_cli.network.spline import Spline
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.evidence import Evidence
from pinn_cli.training.history import History
from pinn_cli.training.solver import Inference, Solver
from pinn_cli.training.steps import first_solution as module

UNKNOWN = Parameter("k", 0, 12.0, 120.0, unknown=True)


@pytest.fixture(scope="module")
def problem() -> Problem:
    made = small_chain("linear")
    record = accelerations(measured(made, snr_db=40.0, duration=20.0, samples=400).record, (1, 2, 3))
    return Problem(made.with_values({UNKNOWN: 12.0}), record, (UNKNOWN,))


def solved(problem: JointProblem) -> Inference:
    return module.first_solution(problem, Solver((Spline(),), History(False)))


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
    found = solved(replace(first, other_starts=(like,)))
    assert found.problem.alone is problem
    assert found.trained.log_evidence == alone.trained.log_evidence
    assert len(asked) == once + 1
    # Where the other one is another solution, both are followed.
    asked.clear()
    solved(replace(first, other_starts=(JointProblem.of(heavier(problem)),)))
    assert len(asked) > once + 1
