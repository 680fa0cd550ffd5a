"""A verdict and the reasons for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

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
        misfit: Of a cause that mends the prediction, the largest NMSE of any channel that stays; 0 of all others.
    """

    kind: str
    suspect: str
    text: str
    word: Word = "questionable"
    misfit: float = 0.0


@dataclass(frozen=True)
class Verdict:
    """What a run is worth.

    Attributes:
        word: ``sound``, ``questionable`` or ``failed``.
        reasons: Likely causes first, then what else the numbers say; of a sound run only what is to be told.
    """

    word: Word
    reasons: tuple[Finding, ...] = ()

    @classmethod
    def of(cls, findings: Sequence[Finding]) -> Verdict:
        """The worst word of all findings; each is told once."""
        word: Word = max((finding.word for finding in findings), key=WORDS.index, default="sound")
        return cls(word, tuple({finding.text: finding for finding in findings}.values()))

    @property
    def sound(self) -> bool:
        """Whether nothing was found."""
        return self.word == "sound"

    def record(self) -> dict[str, Any]:
        """The entries of run.json."""
        return {"verdict": self.word, "reasons": [finding.text for finding in self.reasons]}


def failed_if(condition: bool) -> Word:
    """The word of a finding that is questionable at the least."""
    return "failed" if condition else "questionable"
