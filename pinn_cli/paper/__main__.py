"""``python -m pinn_cli.paper``: what ``make paper``, ``make table2`` and their like run."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

TABLES = tuple(f"table{number}" for number in range(1, 7))


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit status is 1 if a run failed, 130 if it was interrupted."""
    parser = argparse.ArgumentParser(prog="python -m pinn_cli.paper", description=__doc__)
    choices = ("paper", *TABLES, "figures", "seeds", "nonlinearity", "all")
    parser.add_argument("what", nargs="?", choices=choices, default="paper")
    parser.add_argument("--output", type=Path, default=Path("outputs/paper"), help="folder (default: %(default)s)")
    given = parser.parse_args(arguments)
    from pinn_cli.paper import commands  # with torch and matplotlib, which --help need not wait for

    try:
        if given.what in TABLES:
            return commands.make_table(given.what, given.output)
        status: int = getattr(commands, f"make_{given.what}")(given.output)
        return status
    except KeyboardInterrupt:
        print("interrupted: the same command goes on with what is missing", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
