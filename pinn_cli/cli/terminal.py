"""Who is told what a run has found: a person at a terminal, a script, or a program that asks for values."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pinn_cli.runs.reading import printable

# Of run.json, what a script asks for; and tables, by the name that they have in the object.
_OF_RUN = ("verdict", "reasons")
_TABLES = {
    "parameters": "parameters.csv", "modes": "modes.csv", "channels": "inspect.csv", "peaks": "peaks.csv",
    "population": "population.csv", "population_mean": "population_mean.csv",
}  # fmt: skip


@dataclass(frozen=True)
class Terminal:
    """Standard output has results, standard error what a user must know.

    Attributes:
        tells: Whether results are printed.
        last: The last line, from the directory where they are; None: nobody listens, not to errors either.
        bar: Whether progress is shown to somebody who looks.
    """

    tells: bool = True
    last: Callable[[Path], str] | None = lambda directory: printable(str(directory))
    bar: bool = True

    def say(self, text: str) -> None:
        """Print results."""
        if self.tells:
            print(printable(text), flush=True)  # what follows may take long

    def complain(self, text: str) -> None:
        """Print one line on standard error."""
        if self.last is not None:
            print(printable(f"pinn-run: {' '.join(text.split())}"), file=sys.stderr)

    def conclude(self, directory: Path) -> None:
        """Print where the results are: the last line."""
        if self.last is not None:
            print(self.last(directory))


def json_of(directory: Path) -> str:
    """The directory; of a run verdict, reasons, parameters and modes, of a look at a record what it shows.

    What is no number is null.
    """
    output: dict[str, Any] = {"directory": str(directory)}
    if (directory / "run.json").is_file():
        content = json.loads((directory / "run.json").read_text(encoding="utf-8"))
        output |= {name: content.get(name) for name in _OF_RUN}
    for name, file in _TABLES.items():
        if (directory / file).is_file():
            import pandas as pd

            output[name] = [
                {str(k): None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}
                for row in pd.read_csv(directory / file).to_dict(orient="records")
            ]
    return json.dumps(output, ensure_ascii=False, allow_nan=False)


# `--quiet`: errors and the last line. `--json`: errors, and one JSON object. Where Python called, what there is to know
# comes as a value, or is raised.
QUIET, AS_JSON = Terminal(tells=False, bar=False), Terminal(tells=False, last=json_of, bar=False)
SILENCE = Terminal(tells=False, last=None)
