"""The verdict as a whole: the word, the cause first, and the truth nowhere."""

import inspect
from dataclasses import replace

import numpy as np
import pytest
from frame_records import altered
from small_estimates import other_estimate

from pinn_cli.verdict.finding import Finding, Verdict
from pinn_cli.verdict.judge import judge


def test_a_right_estimate_of_a_good_record_is_sound(right_estimate):
    verdict = judge(*right_estimate)
    assert (verdict.word, verdict.reasons, verdict.sound) == ("sound", (), True)
    assert verdict.record() == {"verdict": "sound", "reasons": []}


def test_the_worst_word_wins_and_a_reason_is_told_once():
    one, other = Finding("a", "x", "first"), Finding("b", "y", "second", "failed")
    verdict = Verdict.of([one, other, one])
    assert (verdict.word, [f.text for f in verdict.reasons]) == ("failed", ["first", "second"])


def test_it_never_sees_the_truth():
    names = {"problem", "estimate", "baseline", "free_run", "contradicted"}
    assert set(inspect.signature(judge).parameters) == names


@pytest.mark.parametrize("kind", ["gain", pytest.param("sign", marks=pytest.mark.slow), "clip"])
def test_a_ruined_channel_makes_it_questionable_and_comes_first(right_estimate, kind):
    problem, estimate = right_estimate
    change = {"gain": lambda x: 1.15 * x, "sign": lambda x: -x, "clip": lambda x: np.clip(x, -x.std(), x.std())}[kind]
    verdict = judge(replace(problem, record=altered(problem.record, 2, change)), estimate)
    assert not verdict.sound
    assert verdict.reasons[0].kind == kind
    assert verdict.reasons[0].suspect == "acceleration of DOF 2"


def test_the_prescribed_chain_tells_the_cause_where_the_estimated_one_absorbed_it(right_estimate):
    problem, estimate = right_estimate
    absorbed = [replace(p, estimate=20.0) if p.name == "k_1" else p for p in estimate.parameters]
    record = altered(problem.record, 3, lambda x: x / 9.80665)
    verdict = judge(replace(problem, record=record), replace(estimate, parameters=absorbed))
    assert verdict.word == "failed"
    assert (verdict.reasons[0].kind, verdict.reasons[0].suspect) == ("unit", "acceleration of DOF 3")


def test_where_an_unknown_parameter_starts_is_no_cause(right_estimate):
    """With such springs it does what was measured if the time is in milliseconds; nobody believes in them."""
    problem, estimate = right_estimate
    parameters = problem.structure.parameters
    start = problem.structure.with_parameters(k=1e6 * parameters["k"], c=1e3 * parameters["c"])
    unknown = [other_estimate(p, unknown=True) for p in estimate.parameters]
    summary = estimate.summary | {"stop_reason": "iteration limit"}
    dampers = tuple(p.parameter for p in unknown if p.kind == "c")  # without springs nothing is fitted anew
    verdict = judge(
        replace(problem, structure=start, uncertain=dampers), replace(estimate, parameters=unknown, summary=summary)
    )
    assert [reason.kind for reason in verdict.reasons] == ["not_converged"]


@pytest.mark.slow
def test_a_wrong_mass_is_the_cause(right_estimate):
    problem, estimate = right_estimate
    m = problem.structure.parameters["m"].clone()
    m[1] *= 5.0
    verdict = judge(replace(problem, structure=problem.structure.with_parameters(m=m)), estimate)
    assert (verdict.word, verdict.reasons[0].kind, verdict.reasons[0].suspect) == ("failed", "mass", "m_2")


@pytest.mark.slow
def test_a_wrong_unit_of_time_is_the_cause(right_estimate):
    problem, estimate = right_estimate
    record = replace(problem.record, time=1000.0 * problem.record.time)
    verdict = judge(replace(problem, record=record), estimate)
    assert (verdict.word, verdict.reasons[0].kind) == ("failed", "time_unit")


def test_a_gain_that_believed_parameters_made_up_for_shows_against_the_prescribed_ones(right_estimate):
    problem, estimate = right_estimate
    one = problem.record.keep({"acceleration": [3]})
    record = altered(one, 3, lambda x: 1.15 * x)
    believed = tuple(replace(p, unknown=False) for p in problem.uncertain)
    absorbed = [
        other_estimate(p, estimate=p.estimate / 1.07, prescribed=p.estimate, unknown=False) for p in estimate.parameters
    ]
    verdict = judge(replace(problem, record=record, uncertain=believed), replace(estimate, parameters=absorbed))
    assert verdict.reasons[0].kind == "gain"


@pytest.mark.parametrize(("unknown", "reasons"), [(True, ["contradicted"]), (False, [])])
def test_parameters_that_were_asked_for_have_to_move_the_structure_as_it_moved(right_estimate, unknown, reasons):
    problem, estimate = right_estimate
    asked = [replace(p.parameter, unknown=unknown) for p in estimate.parameters]
    verdict = judge(replace(problem, uncertain=asked), estimate, contradicted=83.1)
    assert [finding.kind for finding in verdict.reasons] == reasons
    assert not reasons or "to 83 % only" in verdict.reasons[0].text
    assert judge(replace(problem, uncertain=asked), estimate).sound
