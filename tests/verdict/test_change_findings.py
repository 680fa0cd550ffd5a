"""What a verdict makes of changes since earlier records."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from pinn_cli.report.over_time import changes_text
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.estimate import Change, Changes
from pinn_cli.verdict.change_findings import change_findings


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
        (
            estimate(1e-6),
            ["the record contradicts the earlier ones and no one parameter explains it (by chance 1e"],
        ),
        (
            estimate(0.0, 1),
            ["the record contradicts the earlier ones beyond what changes of k_2 explain (by chance"],
        ),
        (estimate(0.4, 1, 0), ["k_2, k_1 changed at once"]),
    ],
)
def test_what_is_told(given, told):
    found = change_findings(given)
    assert [finding.text.startswith(text) for finding, text in zip(found, told, strict=True)] == [True] * len(told)
    assert all(finding.word == "questionable" for finding in found)


def test_a_contradiction_is_told_once():
    alone = estimate(1e-6)
    assert changes_text(alone.changes) == ""
    assert len(change_findings(alone)) == 1
    assert changes_text(estimate(0.4).changes).startswith("no change since the earlier records")
    assert changes_text(estimate(0.4, 1).changes).startswith("changed: k_2")
