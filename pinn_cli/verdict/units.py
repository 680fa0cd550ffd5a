"""Factors that a channel is off by when somebody took one unit for another."""

from __future__ import annotations

import math

# Off by no more than this share, a factor is that of a unit.
CLOSE = 0.03

_FACTORS = {
    9.80665: ("9.80665", "g and m/s^2, or kgf and N"),
    1e1: ("10", "a decade"),
    1e2: ("100", "cm and m"),
    1e3: ("1000", "mm and m, or kN and N"),
    1e6: ("1e6", "um and m, or MN and N"),
    25.4: ("25.4", "inches and mm"),
    1 / 0.0254: ("1/0.0254", "inches and m"),
    1 / 0.3048: ("1/0.3048", "feet and m"),
    4.4482216: ("4.448", "pounds-force and N"),
    2 * math.pi: ("2 pi", "Hz and rad/s"),
}


def unit_of(factor: float, std: float = 0.0) -> str:
    """The factor and which two units were taken for each other: ``1/9.80665: g and m/s^2``; "" where no unit fits.

    Args:
        factor: Measured over expected.
        std: Its standard deviation.
    """
    size, sign = abs(factor), "-" if factor < 0 else ""
    allowed = min(CLOSE, max(0.01, 4.0 * std / size)) if size else 0.0
    for exact, (written, units) in _FACTORS.items():
        if abs(size / exact - 1) < allowed:
            return f"{sign}{written}: {units}"
        if abs(size * exact - 1) < allowed:
            inverse = written[2:] if written.startswith("1/") else f"1/{written}"
            return f"{sign}{inverse}: {units}"
    return ""
