"""What an uncertain parameter knows about its own unit and bound."""

from __future__ import annotations

import math

import pytest

from pinn_cli.system.parameters import Parameter


@pytest.mark.parametrize(
    ("prescribed", "prior_std", "scale", "unit"),
    [(15.0, 1.5, None, 15.0), (-15.0, 1.5, None, 15.0), (0.0, 3.0, None, 3.0), (2.0, 30.0, 3.0, 3.0)],
)
def test_the_unit_is_its_scale_or_else_the_larger_of_value_and_prior(prescribed, prior_std, scale, unit):
    assert Parameter("k", 1, prescribed, prior_std, scale).step == unit


def test_it_can_go_down_to_zero_or_anywhere():
    assert Parameter("k", 1, 15.0, 1.0, positive=True).lower == -15.0
    assert Parameter("k", 1, 15.0, 1.0).lower == -math.inf


@pytest.mark.parametrize("prescribed", [0.1, 0.3, 7.3, 123.4])
@pytest.mark.parametrize("prior_std", [0.7, 3.0, 1e3])
def test_a_value_is_never_below_its_bound(prescribed, prior_std):
    bounded = Parameter("k", 1, prescribed, prior_std, positive=True)
    assert bounded.value(bounded.lower) == 0.0
    assert bounded.value(prior_std * (bounded.lower / prior_std) * (1 + 1e-15)) >= 0.0
    assert bounded.value(-0.5 * prescribed) == 0.5 * prescribed
    assert Parameter("k", 1, prescribed, prior_std).value(-2.0 * prescribed) == -prescribed
