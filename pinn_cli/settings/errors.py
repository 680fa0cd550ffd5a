"""What can go wrong for a user, in one line each.

Three kinds are told apart because a shell script must tell them apart: input that no run can use (exit status 2), a
run that diverged (exit status 3), and with ``strict=true`` a run whose verdict is not sound (exit status 4).
Everything else is a defect of the program and keeps its traceback.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

# Of a value that is told, characters.
LONGEST_VALUE = 500


def shortened(value: object) -> str:
    """Its text, cut where it is longer than anybody reads."""
    text = str(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}... ({len(text)} characters)"


class InputError(ValueError):
    """A setting or a file that no run can use.

    Args:
        setting: The setting's name as a user types it (``system.ndof``) or a place in a file (``data.csv, column 'f1',
            line 7``).
        value: What was given.
        allowed: What is allowed.
        hint: The likely cause, or what to do about it.
    """

    def __init__(self, setting: str, value: object, allowed: str, hint: str = "") -> None:
        self.setting, self.value, self.allowed, self.hint = setting, value, allowed, hint
        text = f"{setting}={shortened(value)}: must be {allowed}" + (f"; {shortened(hint)}" if hint else "")
        super().__init__(" ".join(text.split()))

    @classmethod
    def read(cls, text: str) -> InputError:
        """The error that says a text, as one in another process did."""
        setting, _, rest = text.partition("=")
        value, _, rest = rest.partition(": must be ")
        allowed, _, hint = rest.partition("; ")
        return cls(setting, value, allowed, hint)

    def __reduce__(self) -> tuple[type[InputError], tuple[object, ...]]:
        # Exceptions cross process borders in sweeps; the default pickling would call __init__ with the finished text
        # only.
        return type(self), (self.setting, self.value, self.allowed, self.hint)


class DivergenceError(RuntimeError):
    """Training that left the numbers that a computer can hold: which term, at which iteration, what to try."""


class NotSoundError(RuntimeError):
    """A finished run whose verdict is not sound, where ``strict=true`` asks for one that is."""


def suggestion(given: str, names: Iterable[str]) -> str:
    """`did you mean ...?` with the closest of the known names, or nothing if none is close."""
    names = [name for name in names if name != given]
    close = difflib.get_close_matches(given, names, n=1, cutoff=0.6)
    if not close:  # the last part of a dotted or slashed name may be right where the rest is missing: ndof
        last = re.split(r"[./]", given)[-1]
        close = [name for name in names if re.split(r"[./]", name)[-1] == last][:1]
    return f"did you mean {close[0]}?" if close else ""
