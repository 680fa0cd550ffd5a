"""Factors that a channel is off by when somebody took one unit for another."""

from __future__ import annotations

import math

# Off by no more than this share, a factor is that of a unit.
CLOSE = 0.03

_FACTORS = {
    9.80665: "g for m/s^2",
    1e1: "ten times",
    1e2: "cm for m",
    1e3: "a unit for its thousandth (mm for m, kN for N)",
    1e6: "a unit for its millionth",
    25.4: "inches for mm",
    0.0254: "inches for m",
    0.3048: "feet for m",
    4.4482216: "pound-force for N",
    2 * math.pi: "Hz for rad/s",
}


def unit_of(factor: float, std: float = 0.0) -> tuple[float, str] | None:
    """The exact factor and what was taken for what, in either direction; None where no unit fits.

    Args:
        factor: Measured over expected.
        std: Its standard deviation.
    """
    allowed = min(CLOSE, max(0.01, 4.0 * std / abs(factor))) if factor else 0.0
    for exact, which in _FACTORS.items():
        for value, text in ((exact, which), (1 / exact, which)):
            if abs(abs(factor) / value - 1) < allowed:
                return math.copysign(value, factor), text
    return None
