"""Who is told what a command says: a person at a terminal, or nobody, as where Python called it."""

from __future__ import annotations

import sys

from pinn_cli.runs.reading import printable


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
