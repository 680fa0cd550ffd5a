"""What counts as a number, a whole number, a choice or a path in a setting; anything else is one line for the user.

A bool is no number here, although Python thinks so: ``system.ndof=true`` is a mistake.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from pinn_cli.settings.errors import InputError

# A number as people write it.
NUMERAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")

# Magnitudes that no quantity in SI units has, and whose squares and cubes are still numbers.
LARGEST, SMALLEST = 1e30, 1e-30
USABLE = f"between {SMALLEST:g} and {LARGEST:g} in size"
# What libraries take, which count in 64 bits.
LARGEST_WHOLE = 2**63 - 1
# Of numpy's legacy RandomState, which takes 32 bits, with room to count on from channel to channel.
LARGEST_LEGACY_SEED = 2**31


def is_finite_number(value: object) -> bool:
    """Whether it is an int or a float (of Python or numpy), finite; an int beyond all floats is not."""
    try:
        return not isinstance(value, bool) and isinstance(value, Real) and math.isfinite(value)
    except OverflowError:
        return False


def is_usable_number(value: object) -> bool:
    """Whether it is a finite number that can be calculated with: 0, or between `SMALLEST` and `LARGEST` in size."""
    return is_finite_number(value) and (value == 0 or SMALLEST <= abs(value) <= LARGEST)  # type: ignore[arg-type]


def is_whole_number(value: object) -> bool:
    """Whether it is an int (of Python or numpy)."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def entries(value: object) -> list[Any]:
    """The entries of a list; none of anything else, a text included."""
    return list(value) if isinstance(value, Sequence) and not isinstance(value, str) else []


def finite_number(setting: str, value: Any) -> float:
    """The value as a float, or an InputError naming ``setting``."""
    return _number(setting, value, "a finite number", least=-math.inf)


def positive_number(setting: str, value: Any) -> float:
    """The value as a float > 0, or an InputError naming ``setting``."""
    return _number(setting, value, "a finite number > 0", least=math.ulp(0.0))


def non_negative_number(setting: str, value: Any) -> float:
    """The value as a float >= 0, or an InputError naming ``setting``."""
    return _number(setting, value, "a finite number >= 0", least=0.0)


def fraction(setting: str, value: Any, hint: str = "") -> float:
    """The value as a float between 0 and 1, both excluded, or an InputError naming ``setting``."""
    if not is_finite_number(value) or not 0 < value < 1:
        raise InputError(setting, value, "a number between 0 and 1", hint)
    return float(value)


def true_or_false(setting: str, value: Any) -> bool:
    """The value if it is a bool, or an InputError naming ``setting``."""
    if not isinstance(value, bool):
        raise InputError(setting, value, "true or false")
    return value


def whole_number(setting: str, value: Any, least: int = 0, most: int = LARGEST_WHOLE) -> int:
    """The value as an int from ``least`` to ``most``, or an InputError naming ``setting``."""
    if not is_whole_number(value) or value < least:
        raise InputError(setting, value, f"a whole number >= {least}")
    if value > most:
        raise InputError(setting, value, f"a whole number <= {most}")
    return int(value)


def one_of(setting: str, value: Any, choices: Sequence[str]) -> str:
    """The value if it is one of the choices, or an InputError naming ``setting``."""
    if value not in choices:
        raise InputError(setting, value, f"one of {', '.join(choices)}")
    return str(value)


def located(path: str | Path, base: Path | None = None) -> Path:
    """The path with ``~`` spelled out, as a shell would; a relative one starts at ``base``, None: where we are.

    A ``~`` that names nobody's home is taken as it stands: there will be no such file, and that is said of it.
    """
    try:
        path = Path(path).expanduser()
    except RuntimeError:
        path = Path(path)
    return (base or Path()) / path


def _number(setting: str, value: Any, allowed: str, least: float) -> float:
    if not is_finite_number(value) or value < least:
        raise InputError(setting, value, allowed)
    if not is_usable_number(value):
        raise InputError(setting, value, f"{allowed}, {USABLE}")
    return float(value)
