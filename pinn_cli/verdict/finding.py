"""One reason for a verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Word = Literal["sound", "questionable", "failed"]
WORDS: tuple[Word, ...] = get_args(Word)


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with an estimate or with what it was made from.

    Attributes:
        kind: What it is, for programs: ``gain``, ``clip``, ``free_run``, ``parameter``, ...
        suspect: The channel, parameter or setting: ``acceleration of DOF 3``, ``m_2``.
        text: One plain sentence: what was found, and what to try.
        word: The best that the run can be called with this in it.
        left: Of a cause that mends the prediction, the largest NMSE of any channel that stays; 0 of all others.
    """

    kind: str
    suspect: str
    text: str
    word: Word = "questionable"
    left: float = 0.0
