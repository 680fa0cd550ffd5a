"""The method's page: its steps, as docs/method.md tells them."""

import re
from dataclasses import replace
from pathlib import Path

from small_problems import measured, small_chain

from pinn_cli.network.spline import Spline
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.training import inference
from pinn_cli.training.history import History
from pinn_cli.training.solver import Inference, Solver

METHOD = Path(__file__).parents[2] / "docs" / "method.md"


def test_the_docs_tell_the_steps_that_there_are():
    told = re.findall(r"^\| `(\w+)` \| (\d+) \|", METHOD.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert told == [(step.__name__, str(rounds)) for step, rounds in inference.STEPS]


def test_a_step_is_asked_until_it_has_nothing_better_and_so_many_times_at_most(monkeypatch):
    asked: list[str] = []

    def better(found: Inference) -> Inference:
        asked.append("better")
        return replace(found, narrowed=found.narrowed + 1.0)

    def nothing(found: Inference) -> None:
        asked.append("nothing")

    monkeypatch.setattr(inference, "STEPS", ((nothing, 5), (better, 3)))
    structure = small_chain("linear")
    problem = JointProblem.of(Problem(structure, measured(structure, duration=4.0, samples=101).record))
    found = inference.infer(problem, Solver((Spline(),), History(False)))
    assert asked == ["nothing"] + 3 * ["better"]
    assert found.narrowed == 4.0
