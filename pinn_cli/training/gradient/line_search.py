"""A line search that ends where the strong Wolfe conditions hold (Nocedal & Wright 2006, algorithms 3.5 and 3.6)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

# Sufficient decrease and curvature: the usual ones of quasi-Newton methods (Nocedal & Wright, section 3.1).
DECREASE, CURVATURE = 1e-4, 0.9
# Of the value: below this a difference of two values is rounding, and slopes decide (Hager & Zhang 2005, eq. 4.1).
ROUNDING = 1e-14
# Values of the function in one search. Halving an interval so often leaves a millionth of it.
MOST_VALUES = 25


@dataclass(frozen=True)
class Trial:
    """A point on the line: step, value and derivative by the step."""

    step: float
    value: float
    slope: float


class LineSearch:
    """Minimise a function of one number roughly, from a start where it falls.

    Args:
        function: From a step > 0 to value and slope there; neither need be finite.
        start: The point at step 0; its slope is negative.
        largest: Step that must not be exceeded.
    """

    def __init__(self, function: Callable[[float], tuple[float, float]], start: Trial, largest: float) -> None:
        self.function, self.start, self.largest = function, start, largest
        self.best, self.left = start, MOST_VALUES

    def __call__(self, first: float) -> Trial | None:
        """The accepted point, searched from the step ``first`` on.

        Returns:
            A point where the strong Wolfe conditions hold, or the largest step if the function still falls there, or
            failing that the lowest point seen; None where nothing lower was seen.
        """
        previous, here = self.start, self._trial(min(first, self.largest))
        while not self.accepts(here) and self.left:
            if self._too_high(here) or (previous.step > 0 and here.value >= previous.value):
                return self._between(previous, here)
            if here.slope >= 0:
                return self._between(here, previous)
            if here.step >= self.largest:
                return here
            ahead = _minimum_of_cubic(previous, here)
            low, high = here.step + 0.1 * (here.step - previous.step), 10.0 * here.step
            step = high if math.isnan(ahead) or ahead <= here.step else min(max(ahead, low), high)
            previous, here = here, self._trial(min(step, self.largest))
        return here if self.accepts(here) else self._lowest()

    def accepts(self, here: Trial) -> bool:
        """Whether the strong Wolfe conditions hold, the first one up to rounding."""
        return not self._too_high(here) and abs(here.slope) <= -CURVATURE * self.start.slope

    def _too_high(self, here: Trial) -> bool:
        if not (math.isfinite(here.value) and math.isfinite(here.slope)):
            return True
        if here.value <= self.start.value + DECREASE * here.step * self.start.slope:
            return False
        # The same condition for a parabola, by its slope.
        drowned = abs(here.value - self.start.value) <= ROUNDING * abs(self.start.value)
        return not (drowned and here.slope <= (2.0 * DECREASE - 1.0) * self.start.slope)

    def _between(self, low: Trial, high: Trial) -> Trial | None:
        """Narrow an interval that holds an acceptable step; ``low`` is the lower of its ends."""
        while self.left:
            width = high.step - low.step
            step = _minimum_of_cubic(low, high)
            nearest, farthest = sorted((low.step + 0.1 * width, high.step - 0.1 * width))
            if not nearest <= step <= farthest:  # true for NaN too
                step = low.step + 0.5 * width
            if step in (low.step, high.step):
                break
            here = self._trial(step)
            if self.accepts(here):
                return here
            if self._too_high(here) or here.value >= low.value:
                high = here
            else:
                if here.slope * width >= 0:
                    high = low
                low = here
        return self._lowest()

    def _trial(self, step: float) -> Trial:
        self.left -= 1
        here = Trial(step, *self.function(step))
        if here.value < self.best.value and math.isfinite(here.slope):
            self.best = here
        return here

    def _lowest(self) -> Trial | None:
        return self.best if self.best.step > 0 else None


def _minimum_of_cubic(a: Trial, b: Trial) -> float:
    """Where the cubic through two values and slopes is least (Nocedal & Wright, eq. 3.59), NaN where nowhere."""
    if not all(math.isfinite(x) for x in (a.value, a.slope, b.value, b.slope)) or a.step == b.step:
        return math.nan
    first = a.slope + b.slope - 3.0 * (a.value - b.value) / (a.step - b.step)
    square = first * first - a.slope * b.slope
    if not 0 <= square < math.inf:
        return math.nan
    second = math.copysign(math.sqrt(square), b.step - a.step)
    bottom = b.slope - a.slope + 2.0 * second
    return math.nan if bottom == 0 else b.step - (b.step - a.step) * (b.slope + second - first) / bottom
