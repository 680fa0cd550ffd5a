"""What a model lacks, in the verdict."""

from dataclasses import replace

import pytest
from frame_records import altered

from pinn_cli.training.estimate import Doubt
from pinn_cli.verdict.judge import judge

KINDS = {
    "friction": ("connection 2", "the model of connection 2 lacks friction of 3 +- 0.2 N"),
    "cubic term": ("connection 2", "the model of connection 2 lacks a cubic term of 3 +- 0.2 N"),
    "m": ("DOF 2", "the mass of DOF 2"),
    "gain": ("acceleration of DOF 2", "the acceleration of DOF 2 shows 4 +- 0.2 times"),
    "delay": ("acceleration of DOF 2", "the acceleration of DOF 2 is 3 +- 0.2 N late"),
    "tilt": ("acceleration of DOF 2", "the acceleration of DOF 2 follows the displacement"),
    "rocking": ("base", "the base rocks: if storeys are of one height, it is 3e+02 +- 2e+01 %"),
    "force": ("DOF 1", "what the model leaves out acts on DOF 1 alone"),
    "high_pass": ("acceleration of all sensors", "high_pass: 3 (data.channels)"),
}


@pytest.mark.parametrize("kind", KINDS)
def test_what_moves_the_estimate_comes_first_and_is_not_sound(right_estimate, kind: str):
    problem, estimate = right_estimate
    of, text = KINDS[kind]
    doubt = Doubt(kind, of, 3.0, 0.2, "N", 40.0, 5.0, "k_1")
    verdict = judge(problem, replace(estimate, doubts=(doubt,)))
    assert verdict.word == "questionable"
    assert text in verdict.reasons[0].text
    assert "exp(40) times" in verdict.reasons[0].text


def test_what_moves_nothing_is_told_of_a_sound_run(right_estimate):
    problem, estimate = right_estimate
    doubt = Doubt("friction", "connection 2", 3.0, 0.2, "N", 40.0, 0.3, "k_1")
    verdict = judge(problem, replace(estimate, doubts=(doubt,)))
    assert verdict.word == "sound"
    assert [reason.kind for reason in verdict.reasons] == ["friction"]


def test_what_is_small_is_told_by_the_structure_whose_parameters_are_free(right_estimate):
    problem, estimate = right_estimate
    problem = replace(problem, record=altered(problem.record, 2, lambda x: 1.1 * x))
    assert judge(problem, estimate).reasons[0].suspect == "acceleration of DOF 2"
    doubt = Doubt("delay", "force on DOF 3", 3.0, 0.2, "s", 40.0, 5.0, "k_1")
    assert judge(problem, replace(estimate, doubts=(doubt,))).reasons[0].suspect == "force on DOF 3"


def test_a_fault_goes_before_what_a_model_lacks_that_is_excused_from_following_the_sensors(right_estimate):
    problem, estimate = right_estimate
    wide = [replace(p, std=0.5 * p.estimate) for p in estimate.parameters]
    uncertain = replace(estimate, parameters=wide, doubts=(Doubt("mode", "DOF 1", 0.7, 0.1, "kg", 40.0, 5.0, "k_1"),))
    wrong = replace(problem, record=altered(problem.record, 3, lambda x: x / 9.80665))
    kinds = [reason.kind for reason in judge(wrong, uncertain).reasons]
    assert kinds[0] == "unit"
    assert "free_run" not in kinds
    assert judge(problem, uncertain).reasons[0].kind == "mode"
