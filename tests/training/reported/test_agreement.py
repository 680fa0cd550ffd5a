"""Records of one structure agree within chance; one of another structure does not."""

from dataclasses import replace
from functools import cache

import pytest
from small_problems import measured, small_chain
from solved_records import by_spline

from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.training.estimate import Estimate
from pinn_cli.verdict.judge import APART, contradictions


@cache
def solved(second_k: float) -> Estimate:
    """Two records with sensors on every DOF, the second of a chain with other springs."""
    every = [
        measured(small_chain("linear", 2, k=k), snr_db=30.0, duration=24.0, samples=385, seed=seed).record
        for seed, k in enumerate((15.0, second_k))
    ]
    scheme = StateParameter(unknown=["k_*"], parameter_uncertainty=0.0)
    return by_spline(scheme.pose(small_chain("linear", 2), every))


def test_records_of_one_structure_agree_within_chance():
    found = solved(15.0)
    assert [d.freedom for d in found.disagreements] == [2, 2]
    for one in found.disagreements:
        assert one.square < 15.0  # of a chi-square of two: one in 1800
        assert list(one.alone) == ["k_1", "k_2"]
        for name, value in one.alone.items():
            assert value == pytest.approx(15.0, rel=0.03), name
    assert not contradictions(found)
    assert not found.by_record[0].disagreements


@pytest.mark.slow
def test_a_record_of_another_structure_contradicts_the_rest():
    found = solved(18.0)
    assert max(d.square for d in found.disagreements) > 2.0 * APART**2
    (finding,) = contradictions(found)
    assert (finding.kind, finding.word) == ("contradiction", "questionable")
    assert "contradicts the other one: by itself it says k_" in finding.text
    assert "\n" not in finding.text


@pytest.mark.parametrize(("off", "told"), [(1.01, False), (1.05, True)])
def test_a_pull_beyond_chance_needs_a_difference_that_is_worth_a_word(off, told):
    found = solved(15.0)
    alone = {p.name: off * p.estimate for p in found.parameters}
    first, second = found.disagreements
    pulling = replace(second, square=1e4, alone=alone)
    assert bool(contradictions(replace(found, disagreements=(first, pulling)))) == told
