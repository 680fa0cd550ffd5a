"""The axis of one parameter: what it spans, in which power of ten, and how many ticks there is room for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axis import XAxis
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from pinn_cli.report.figures import style
from pinn_cli.training.estimated_chain import split_name

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axis import Axis

TAIL = 0.0005  # one draw in a thousand may widen a histogram to no purpose
MARGIN = 0.06  # of the span, on either side
TRUTH_WITHIN = 2.0  # spans: a truth that is further off is left out, else the draws would be a line

_CHARACTER, _LINE = 0.5, 1.2  # width of a digit and height of a line over the font's size
_SPACE, _SPACE_UP = 1.5, 1.0  # between tick labels: characters, and lines


@dataclass(frozen=True)
class ParameterAxis:
    """An axis of a parameter, in its unit.

    Attributes:
        limits: Lowest and highest value shown.
        label: Symbol, power of ten and unit.
        factor: Power of ten by which the tick labels are multiplied.
        true: Where the true value is marked; NaN where it is unknown or too far off.
    """

    limits: tuple[float, float]
    label: str
    factor: float = 1.0
    true: float = math.nan

    @classmethod
    def around(
        cls, name: str, values: np.ndarray, true: float, units: Mapping[str, str], tail: float = TAIL
    ) -> ParameterAxis:
        """The axis on which the draws (draws,) and, if it is not far from them, the true value are seen.

        A share ``tail`` of the draws may lie outside, on either side.
        """
        lower, upper = np.quantile(values, (tail, 1.0 - tail))
        span = upper - lower
        if not span > 1e-9 * max(abs(lower), abs(upper)):  # all draws are the same
            span = 0.1 * abs(lower) or 1.0
            lower, upper = lower - 0.5 * span, upper + 0.5 * span
        near = lower - TRUTH_WITHIN * span <= true <= upper + TRUTH_WITHIN * span
        if near:
            lower, upper = min(lower, true), max(upper, true)
        margin = MARGIN * (upper - lower)
        limits = (float(lower - margin), float(upper + margin))
        factor, label = _scaled(name, max(map(abs, limits)), units)
        return cls(limits, label, factor, true if near else math.nan)

    def dress(self, axis: Axis, length: float, size: float) -> None:
        """Limits, and as many ticks as there is room for.

        Args:
            axis: Horizontal or vertical.
            length: inch.
            size: Of the tick labels, points.
        """
        horizontal = isinstance(axis, XAxis)
        set_limits = axis.axes.set_xlim if horizontal else axis.axes.set_ylim
        set_limits(*self.limits)
        ticks, decimals = self._ticks(length * 72.0 / (size * (_CHARACTER if horizontal else _LINE)), horizontal)
        axis.set_major_locator(FixedLocator([tick / self.factor for tick in ticks]))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value * self.factor:.{decimals}f}"))
        axis.set_tick_params(labelsize=size)

    def _ticks(self, room: float, horizontal: bool) -> tuple[np.ndarray, int]:
        """Tick values, multiplied by the factor, and their decimals; ``room`` is in characters or in lines."""
        lower, upper = (limit * self.factor for limit in self.limits)
        for count in (4, 3, 2, 1):
            ticks = np.asarray(MaxNLocator(count, steps=[1, 2, 2.5, 5, 10], min_n_ticks=1).tick_values(lower, upper))
            decimals = max(_decimals(step) for step in np.diff(ticks)[:1])
            width = max(len(f"{tick:.{decimals}f}") for tick in ticks) if horizontal else 1.0
            # A label across an end would run into the next panel's; the gap between them has room for a character.
            inside = 0.5 * (width - (1.0 if horizontal else 0.0)) / room * (upper - lower)
            ticks = ticks[(ticks >= lower + inside) & (ticks <= upper - inside)]
            space = _SPACE if horizontal else _SPACE_UP
            if len(ticks) and len(ticks) * (width + space) - space <= room:
                break
        return ticks, decimals


def _decimals(step: float) -> int:
    """Decimals that tell multiples of ``step`` apart."""
    return next((n for n in range(12) if abs(round(step, n) - step) < 1e-6 * step), 12)


def _scaled(name: str, magnitude: float, units: Mapping[str, str]) -> tuple[float, str]:
    """Factor and label: values of 10 000 and more, or below 0.01, are shown in powers of a thousand."""
    symbol, unit = style.parameter_symbol(name), style.raised(units.get(split_name(name)[0], ""))
    power = 3 * math.floor(math.log10(magnitude) / 3.0) if magnitude > 0.0 else 0
    if 1e-2 <= magnitude < 1e4:
        power = 0
    shown = [rf"$10^{{{power}}}$"] * bool(power) + [unit] * bool(unit)
    return 10.0**-power, f"{symbol} ({' '.join(shown)})" if shown else symbol
