"""What a user may have meant by a name that does not exist."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable


def suggestion(given: str, known: Iterable[str]) -> str:
    """`did you mean ...?` with the closest of the known names, or nothing if none is close."""
    known = [name for name in known if name != given]
    close = difflib.get_close_matches(given, known, n=1, cutoff=0.6)
    if not close:  # the last part of a dotted or slashed name may be right where the rest is missing: ndof
        last = re.split(r"[./]", given)[-1]
        close = [name for name in known if re.split(r"[./]", name)[-1] == last][:1]
    return f"did you mean {close[0]}?" if close else ""
