"""Several records before one verdict, and changes since earlier ones."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from independent_records import Structure as Storeys
from independent_records import measured
from storeys import C, K, M, response

from pinn_cli.record.response import Response
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.estimate import Change, Changes, Estimate, ParameterEstimate
from pinn_cli.verdict.finding import Finding, Verdict
from pinn_cli.verdict.judge import change_findings, judge, verdict_of_records


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
    assert found.word == "failed"
    assert [finding.text for finding in found.reasons] == [
        "the record does not determine k_2",
        "record 2: no free run",
        "record 3: the noise found is at its lower bound",
    ]
    assert found.reasons[2].suspect == "record 3: acceleration of DOF 1"


def test_one_record_is_judged_as_it_always_was():
    alone = Verdict.of([NOISE])
    assert verdict_of_records([alone]) == alone
    assert verdict_of_records([None]) is None
    assert verdict_of_records([Verdict.of([]), Verdict.of([])]).sound
