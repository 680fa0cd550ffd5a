"""One verdict on several records."""

from __future__ import annotations

from pinn_cli.verdict.finding import Finding, Verdict
from pinn_cli.verdict.records import verdict_of_records

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
