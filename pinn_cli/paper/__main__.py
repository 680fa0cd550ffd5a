"""``python -m pinn_cli.paper``: what ``make paper``, ``make table2`` and its like run."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from pinn_cli.paper.cases import TABLES
from pinn_cli.paper.commands import make_all, make_figures, make_nonlinearity, make_paper, make_seeds, make_table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

MAKERS: dict[str, Callable[[Path], int]] = {
    "paper": make_paper,
    **{table.name: partial(make_table, table.name) for table in TABLES},
    "figures": make_figures,
    "seeds": make_seeds,
    "nonlinearity": make_nonlinearity,
    "all": make_all,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit status is 1 if a run failed, 130 if it was interrupted."""
    parser = argparse.ArgumentParser(prog="python -m pinn_cli.paper", description=__doc__)
    parser.add_argument("what", nargs="?", choices=tuple(MAKERS), default="paper")
    parser.add_argument("--output", type=Path, default=Path("outputs/paper"), help="folder (default: %(default)s)")
    given = parser.parse_args(arguments)
    try:
        return MAKERS[given.what](given.output)
    except KeyboardInterrupt:
        print("interrupted: the same command goes on with what is missing", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
