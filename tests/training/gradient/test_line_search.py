"""The line search on functions of one number with known difficulties."""

from __future__ import annotations

import math

import pytest

from pinn_cli.training.gradient.line_search import CURVATURE, DECREASE, LineSearch, Trial

FUNCTIONS = {
    "parabola": (lambda t: (t - 3.0) ** 2, lambda t: 2.0 * (t - 3.0)),
    # Moré & Thuente 1994, eqs. 5.1 and 5.2
    "flat": (lambda t: -t / (t * t + 2.0), lambda t: (t * t - 2.0) / (t * t + 2.0) ** 2),
    "steep": (lambda t: (t + 0.004) ** 5 - 2 * (t + 0.004) ** 4, lambda t: 5 * (t + 0.004) ** 4 - 8 * (t + 0.004) ** 3),
    "wavy": (lambda t: 0.1 * t * t - math.sin(3.0 * t), lambda t: 0.2 * t - 3.0 * math.cos(3.0 * t)),
    "wall": (lambda t: -t if t < 1.0 else math.inf, lambda t: -1.0 if t < 1.0 else math.nan),
}


def search(name: str, first: float, largest: float = math.inf) -> tuple[Trial, Trial | None]:
    value, slope = FUNCTIONS[name]
    start = Trial(0.0, value(0.0), slope(0.0))
    return start, LineSearch(lambda t: (value(t), slope(t)), start, largest)(first)


@pytest.mark.parametrize("first", [1e-3, 0.1, 1.0, 10.0])
@pytest.mark.parametrize("name", ["parabola", "flat", "steep", "wavy"])
def test_the_strong_wolfe_conditions_hold(name, first):
    start, found = search(name, first)
    assert found is not None
    assert found.value <= start.value + DECREASE * found.step * start.slope
    assert abs(found.slope) <= -CURVATURE * start.slope


def test_a_step_stays_within_its_largest():
    start, found = search("parabola", 1.0, largest=0.01)
    assert found is not None
    assert found.step == 0.01
    assert found.value < start.value


def test_numbers_that_are_not_finite_count_as_too_high():
    start, found = search("wall", 64.0)
    assert found is not None
    assert 0.0 < found.step < 1.0
    assert found.value < start.value


def test_nothing_lower_is_none():
    start = Trial(0.0, 1.0, -1.0)
    assert LineSearch(lambda t: (1.0 + t, 1.0), start, math.inf)(1.0) is None


def test_slopes_decide_where_values_drown_in_rounding():
    def function(t: float) -> tuple[float, float]:
        return 1e6 + 1e-12 * (t - 1.0) ** 2, 2e-12 * (t - 1.0)

    found = LineSearch(function, Trial(0.0, *function(0.0)), math.inf)(0.9)
    assert found is not None
    assert found.step == 0.9
