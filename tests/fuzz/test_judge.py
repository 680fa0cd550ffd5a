"""The judge of trials sees what must not be."""

from __future__ import annotations

from dataclasses import replace

import pytest
from fuzz.judge import LONGEST_LINE, Outcome
from fuzz.trial import Trial

TRIAL = Trial("options", ("seed=-1",))
REFUSED = Outcome(2, "", "pinn-run: seed=-1: must be a whole number >= 0\n", 1.0, (), False)
DONE = Outcome(0, "verdict: sound\n/outputs\n", "", 1.0, ("outputs/fitness.csv",), False)


@pytest.mark.parametrize("outcome", [REFUSED, DONE, Outcome(3, "", "pinn-run: diverged\n", 1.0, ("run.json",), False)])
def test_one_line_or_a_verdict_is_no_fault(outcome: Outcome) -> None:
    assert outcome.fault(TRIAL) == ""


@pytest.mark.parametrize(
    ("outcome", "fault"),
    [
        (replace(REFUSED, executed=True), "code of the input was executed"),
        (replace(REFUSED, status=None), "still running"),
        (replace(REFUSED, status=-11), "exit status -11"),
        (replace(REFUSED, status=1), "exit status 1"),
        (replace(REFUSED, err="Traceback (most recent call last):\n"), "traceback"),
        (replace(REFUSED, err=""), "0 lines"),
        (replace(REFUSED, err=2 * REFUSED.err), "2 lines"),
        (replace(REFUSED, err=f"a warning\n{REFUSED.err}"), "not a line of pinn-run's: a warning"),
        (replace(REFUSED, err=f"pinn-run: {'x' * LONGEST_LINE}\n"), "a line of 1510 characters"),
        (replace(REFUSED, changes=("run/run.lock",)), "refused, but changed run/run.lock"),
        (replace(DONE, out="/outputs\n"), "no verdict"),
    ],
)
def test_a_fault_is_named(outcome: Outcome, fault: str) -> None:
    assert fault in outcome.fault(TRIAL)
