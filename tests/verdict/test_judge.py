"""The verdict as a whole: the word, the cause first, what a model lacks, several records; and the truth nowhere."""

import inspect
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from frame_records import altered
from independent_records import Structure as Storeys
from independent_records import measured
from small_estimates import other_estimate
from storeys import C, K, M, response

from pinn_cli.record.response import Response
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.estimate import Change, Changes, Doubt, Estimate, ParameterEstimate
from pinn_cli.verdict.finding import Finding, Verdict
from pinn_cli.verdict.judge import change_findings, judge, verdict_of_records


def test_a_right_estimate_of_a_good_record_is_sound_and_the_truth_is_never_seen(right_estimate):
    verdict = judge(*right_estimate)
    assert (verdict.word, verdict.reasons, verdict.sound) == ("sound", (), True)
    assert verdict.record() == {"verdict": "sound", "reasons": []}
    names = {"problem", "estimate", "baseline", "free_run", "contradicted"}
    assert set(inspect.signature(judge).parameters) == names


@pytest.mark.parametrize("kind", ["gain", pytest.param("sign", marks=pytest.mark.slow), "clip"])
def test_a_ruined_channel_makes_it_questionable_and_comes_first(problem, estimate, kind):
    change = {"gain": lambda x: 1.15 * x, "sign": lambda x: -x, "clip": lambda x: np.clip(x, -x.std(), x.std())}[kind]
    verdict = judge(replace(problem, record=altered(problem.record, 2, change)), estimate)
    assert not verdict.sound
    assert verdict.reasons[0].kind == kind
    assert verdict.reasons[0].suspect == "acceleration of DOF 2"


@pytest.mark.parametrize(("std", "blamed"), [(0.01, True), (10.0, False)])
def test_a_sensor_is_blamed_without_a_cause_only_where_deviations_do_not_allow_what_it_shows(
    problem, estimate, std, blamed
):
    noise = np.random.default_rng(1).standard_normal
    record = altered(problem.record, 2, lambda x: x + 0.6 * x.std() * noise(len(x)))
    known = [replace(p, std=std) if p.kind == "k" else p for p in estimate.parameters]
    verdict = judge(replace(problem, record=record), replace(estimate, parameters=known))
    assert [finding.kind == "sensor" for finding in verdict.reasons].count(True) == int(blamed)


def test_the_prescribed_chain_tells_the_cause_where_the_estimated_one_absorbed_it(problem, estimate):
    absorbed = [replace(p, estimate=20.0) if p.name == "k_1" else p for p in estimate.parameters]
    record = altered(problem.record, 3, lambda x: x / 9.80665)
    verdict = judge(replace(problem, record=record), replace(estimate, parameters=absorbed))
    assert verdict.word == "failed"
    assert (verdict.reasons[0].kind, verdict.reasons[0].suspect) == ("unit", "acceleration of DOF 3")


def test_where_an_unknown_parameter_starts_is_no_cause(problem, estimate):
    """With such springs it does what was measured if the time is in milliseconds; nobody believes in them."""
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
def test_a_wrong_mass_and_a_wrong_unit_of_time_are_causes(problem, estimate):
    m = problem.structure.parameters["m"].clone()
    m[1] *= 5.0
    verdict = judge(replace(problem, structure=problem.structure.with_parameters(m=m)), estimate)
    assert (verdict.word, verdict.reasons[0].kind, verdict.reasons[0].suspect) == ("failed", "mass", "m_2")
    record = replace(problem.record, time=1000.0 * problem.record.time)
    verdict = judge(replace(problem, record=record), estimate)
    assert (verdict.word, verdict.reasons[0].kind) == ("failed", "time_unit")


def test_a_gain_that_believed_parameters_made_up_for_shows_against_the_prescribed_ones(problem, estimate):
    one = problem.record.keep({"acceleration": [3]})
    record = altered(one, 3, lambda x: 1.15 * x)
    believed = tuple(replace(p, unknown=False) for p in problem.uncertain)
    absorbed = [
        other_estimate(p, estimate=p.estimate / 1.07, prescribed=p.estimate, unknown=False) for p in estimate.parameters
    ]
    verdict = judge(replace(problem, record=record, uncertain=believed), replace(estimate, parameters=absorbed))
    assert verdict.reasons[0].kind == "gain"


@pytest.mark.parametrize(("unknown", "reasons"), [(True, ["contradicted"]), (False, [])])
def test_parameters_that_were_asked_for_have_to_move_the_structure_as_it_moved(problem, estimate, unknown, reasons):
    asked = [replace(p.parameter, unknown=unknown) for p in estimate.parameters]
    verdict = judge(replace(problem, uncertain=asked), estimate, contradicted=83.1)
    assert [finding.kind for finding in verdict.reasons] == reasons
    assert not reasons or "to 83 % only" in verdict.reasons[0].text
    assert judge(replace(problem, uncertain=asked), estimate).sound


KINDS = {
    "friction": ("connection 2", "the model of connection 2 lacks friction of 3 +- 0.2 N"),
    "cubic term": ("connection 2", "the model of connection 2 lacks a cubic term of 3 +- 0.2 N"),
    "m": ("DOF 2", "the mass of DOF 2"),
    "gain": ("acceleration of DOF 2", "the acceleration of DOF 2 shows 4 +- 0.2 times"),
    "delay": ("acceleration of DOF 2", "the acceleration of DOF 2 is 3 +- 0.2 N late"),
    "tilt": ("acceleration of DOF 2", "the acceleration of DOF 2 follows the displacement"),
    "rocking": ("base", "the base rocks: if storeys are of one height, it is 3e+02 +- 2e+01 %"),
    "link": ("DOFs 1, 3", "DOFs 1, 3 are joined by 3 +- 0.2 N"),
    "force": ("DOF 1", "what the model leaves out acts on DOF 1 alone"),
    "high_pass": ("acceleration of all sensors", "high_pass: 3 (data.channels)"),
}


FAST = ("friction", "m", "gain", "force")


@pytest.mark.parametrize("kind", [pytest.param(kind, marks=() if kind in FAST else pytest.mark.slow) for kind in KINDS])
def test_what_moves_the_estimate_comes_first_and_is_not_sound(problem, estimate, kind: str):
    of, text = KINDS[kind]
    doubt = Doubt(kind, of, 3.0, 0.2, "N", 40.0, 5.0, "k_1")
    verdict = judge(problem, replace(estimate, doubts=(doubt,)))
    assert verdict.word == "questionable"
    assert text in verdict.reasons[0].text
    assert "exp(40) times" in verdict.reasons[0].text


def test_what_moves_nothing_is_told_of_a_sound_run_and_what_is_small_by_the_structure_that_is_free(problem, estimate):
    doubt = Doubt("friction", "connection 2", 3.0, 0.2, "N", 40.0, 0.3, "k_1")
    verdict = judge(problem, replace(estimate, doubts=(doubt,)))
    assert (verdict.word, [reason.kind for reason in verdict.reasons]) == ("sound", ["friction"])
    problem = replace(problem, record=altered(problem.record, 2, lambda x: 1.1 * x))
    assert judge(problem, estimate).reasons[0].suspect == "acceleration of DOF 2"
    doubt = Doubt("delay", "force on DOF 3", 3.0, 0.2, "s", 40.0, 5.0, "k_1")
    assert judge(problem, replace(estimate, doubts=(doubt,))).reasons[0].suspect == "force on DOF 3"


@pytest.mark.parametrize(("share", "suspects"), [(0.1, ["m_2", "DOF 3"]), (0.9, ["DOF 3"])])
def test_where_a_doubt_explains_little_the_spectra_are_asked(problem, estimate, monkeypatch, share, suspects):
    """However little they miss."""
    told = [Finding("mass", "m_2", "with m_2 = 12 kg the structure does what was measured")]
    monkeypatch.setattr(
        "pinn_cli.verdict.judge.fitted_causes", lambda *_: told if _[-1] == 0.0 else pytest.fail("nothing is missed")
    )
    doubt = Doubt("m", "DOF 3", -0.1, 0.01, "kg", 40.0, 5.0, "k_1", share=share)
    verdict = judge(problem, replace(estimate, doubts=(doubt,)))
    assert [reason.suspect for reason in verdict.reasons] == suspects


@pytest.mark.slow
def test_a_fault_goes_before_what_a_model_lacks_that_is_excused_from_following_the_sensors(problem, estimate):
    wide = [replace(p, std=0.5 * p.estimate) for p in estimate.parameters]
    uncertain = replace(estimate, parameters=wide, doubts=(Doubt("mode", "DOF 1", 0.7, 0.1, "kg", 40.0, 5.0, "k_1"),))
    wrong = replace(problem, record=altered(problem.record, 3, lambda x: x / 9.80665))
    kinds = [reason.kind for reason in judge(wrong, uncertain).reasons]
    assert kinds[0] == "unit"
    assert "free_run" not in kinds
    assert judge(problem, uncertain).reasons[0].kind == "mode"


def estimate(chance: float, *changed: int) -> SimpleNamespace:
    parameters = tuple(Parameter("k", i, 100.0, 1.0) for i in range(3))
    found = tuple(Change(parameters[i], -5.0, 0.1, 1e-9, 1.0) for i in changed)
    return SimpleNamespace(changes=Changes(parameters, found, chance, 1e-3, *np.zeros((4, 3))))


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (SimpleNamespace(changes=None), []),
        (estimate(0.4), []),
        (estimate(0.4, 1), []),
        (estimate(1e-6), ["the record contradicts the earlier ones and no one parameter explains it (by chance 1e"]),
        (estimate(0.0, 1), ["the record contradicts the earlier ones beyond what changes of k_2 explain (by chance"]),
        (estimate(0.4, 1, 0), ["k_2, k_1 changed at once"]),
    ],
)
def test_what_is_told(given, told):
    found = change_findings(given)
    assert [finding.text.startswith(text) for finding, text in zip(found, told, strict=True)] == [True] * len(told)
    assert all(finding.word == "questionable" for finding in found)


@pytest.mark.parametrize("named", [True, False])
def test_a_change_that_is_named_is_no_wrong_mass_or_spring(named):
    """The earlier structure does with another mass what a spring of four fifths does; the present one is not it."""
    k = K * np.array([1.0, 0.8, 1.0])
    made = measured(Storeys(M, C, k, np.zeros(3)), response(1, k, 20.0), {"acceleration": (1, 3)}, 30.0, 1)
    structure = build_chain(3, Linear(), m=M.tolist(), c=C.tolist(), k=K.tolist())
    uncertain = tuple(replace(p, prior_std=0.01 * p.prescribed) for p in structure.every_parameter() if p.kind == "k")
    found = [
        ParameterEstimate(p, now, 1e-3 * now, now, now) for p, now in zip(uncertain, k if named else K, strict=True)
    ]
    change = Change(uncertain[1], -0.2 * K[1], 1e3, 1e-9, 1.0)
    changes = Changes(uncertain, (change,) if named else (), 0.5, 1e-3, *np.zeros((4, 3)))
    std = Response(made.truth.time, *(np.full((1000, 3), 1e-6) for _ in range(4)))
    stopped = {"stop_reason": "iteration limit"}  # a reason to look for causes
    given = Estimate(made.truth, std, found, pd.DataFrame(), stopped, changes=changes)
    reasons = judge(Problem(structure, made.record, uncertain), given).reasons
    assert any(reason.kind in ("mass", "stiffness") for reason in reasons) != named


PARAMETER = Finding("not_identified", "k_2", "the record does not determine k_2")
NOISE = Finding("noise_at_bound", "acceleration of DOF 1", "the noise found is at its lower bound")
FAILED = Finding("free_run", "model", "no free run", "failed")


def test_what_every_record_says_is_told_once_and_the_worst_word_counts():
    each = [Verdict.of([PARAMETER]), Verdict.of([PARAMETER, FAILED]), Verdict.of([NOISE, PARAMETER])]
    found = verdict_of_records(each)
    assert found.word == Verdict.of([PARAMETER, FAILED, PARAMETER]).word == "failed"
    assert Verdict.of([PARAMETER, FAILED, PARAMETER]).reasons == (PARAMETER, FAILED)
    assert [finding.text for finding in found.reasons] == [
        "the record does not determine k_2",
        "record 2: no free run",
        "record 3: the noise found is at its lower bound",
    ]
    assert found.reasons[2].suspect == "record 3: acceleration of DOF 1"
    alone = Verdict.of([NOISE])
    assert verdict_of_records([alone]) == alone
    assert verdict_of_records([None]) is None
    assert verdict_of_records([Verdict.of([]), Verdict.of([])]).sound
