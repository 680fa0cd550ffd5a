"""The verdict in words."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from pinn_cli.report.terminal.columns import WIDTH

if TYPE_CHECKING:
    from pinn_cli.verdict.judge import Verdict


def verdict_text(verdict: Verdict) -> str:
    """The verdict in one line; what is not sound has its reasons above it, one after the other.

    The line is the last but one of a run, whose last is the directory.
    """
    reasons = [reason for finding in verdict.reasons for reason in _folded(finding.text)]
    return "\n".join([*reasons, f"verdict: {verdict.word}"])


def _folded(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent="- ", subsequent_indent="  ", break_on_hyphens=False)
