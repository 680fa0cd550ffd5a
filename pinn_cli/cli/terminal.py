"""Who is told what a command says: a person at a terminal, or nobody, as where Python called it."""

from __future__ import annotations

import sys
import unicodedata


class Terminal:
    """Standard output has results, standard error what a user must know."""

    def say(self, text: str) -> None:
        """Print results."""
        print(printable(text))

    def complain(self, text: str) -> None:
        """Print one line on standard error."""
        print(printable(f"pinn-run: {' '.join(text.split())}"), file=sys.stderr)


class Silence(Terminal):
    """Nobody listens: what there is to know comes as a value, or is raised."""

    def say(self, text: str) -> None:
        """Print nothing."""

    def complain(self, text: str) -> None:
        """Print nothing."""


def printable(text: str) -> str:
    r"""A text whose control characters are written out, as ``\x1b``: files of others may hold some for a terminal."""
    return "".join(
        character.encode("unicode_escape").decode()
        if character not in "\n\t" and unicodedata.category(character).startswith("C")
        else character
        for character in text
    )
