"""``python -m pinn_cli.paper``: what ``make paper`` and its like run; what is missing is made first."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from pinn_cli.paper.realisations import ScoredRealisations, Solver, solve
from pinn_cli.paper.report import copy_figures, paper_figures, write_report
from pinn_cli.paper.runs import TABLES, FinishedRun, PlannedRun, Runner, make_runs, planned_runs, read_runs, run_case
from pinn_cli.paper.studies import NonlinearityScores, SeedScores, nonlinearity_realisations, seed_realisations
from pinn_cli.paper.tables import paper_tables
from pinn_cli.runs.process import usable_cores


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit status is 1 if a run failed, 130 if it was interrupted."""
    parser = argparse.ArgumentParser(prog="python -m pinn_cli.paper", description=__doc__)
    made: dict[str, Callable[[Path], int]] = {
        "paper": make_paper,
        "figures": make_figures,
        "seeds": make_seeds,
        "nonlinearity": make_nonlinearity,
    }
    tables = [table.name for table in TABLES]
    parser.add_argument("what", nargs="?", choices=(*made, *tables, "all"), default="paper")
    parser.add_argument("--output", type=Path, default=Path("outputs/paper"), help="folder (default: %(default)s)")
    given = parser.parse_args(arguments)
    try:
        if given.what in tables:
            return make_table(given.what, given.output)
        wanted = ("paper", "seeds", "nonlinearity") if given.what == "all" else (given.what,)
        return max([made[name](given.output) for name in wanted])
    except KeyboardInterrupt:
        print("interrupted: the same command goes on with what is missing", file=sys.stderr)
        return 130


def make_paper(output: Path, runner: Runner = run_case) -> int:
    """Make the runs that are missing in ``<output>/runs``, then tables, figures and report.

    1 if a run failed: what could be made without it is there nevertheless; else 0.
    """
    runs, failures = _made(planned_runs(), output, runner)
    print(write_report(runs, failures, output))
    return 1 if failures else 0


def make_table(name: str, output: Path, runner: Runner = run_case) -> int:
    """Make the runs of one table, where they are missing; write and print it; as `make_paper`."""
    chosen = [table for table in TABLES if table.name == name]
    runs, failures = _made(planned_runs(chosen), output, runner)
    (table,) = paper_tables(runs, chosen)
    table.write(output / "tables")
    print(f"\n{table.sheet.markdown}\n\n{output / 'tables' / name}.csv")
    return 1 if failures else 0


def make_figures(output: Path, runner: Runner = run_case) -> int:
    """Make the runs that draw a figure, where they are missing, and copy the figures; as `make_paper`."""
    needed = {figure.run for figure in paper_figures()}
    runs, failures = _made([run for run in planned_runs() if run.name in needed], output, runner)
    copy_figures(runs, output / "figures")
    print(output / "figures")
    return 1 if failures else 0


def _made(planned: Sequence[PlannedRun], output: Path, runner: Runner) -> tuple[list[FinishedRun], list[str]]:
    return make_runs(planned, output / "runs", runner, at_once=len(usable_cores()))


def make_seeds(output: Path, solver: Solver = solve) -> int:
    """Solve what is missing of Tables 2 and 5 over the noise seeds, in ``<output>/seeds``; as `make_paper`."""
    scored = ScoredRealisations.made(seed_realisations(), output / "seeds" / "runs", solver)
    print(SeedScores.of(scored).write(output / "seeds"))
    _rewrite_report(output)
    return 1 if scored.failures or scored.missing else 0


def make_nonlinearity(output: Path, solver: Solver = solve) -> int:
    """The same over nonlinearity and force, in ``<output>/nonlinearity``; a training that diverges is a finding."""
    scored = ScoredRealisations.made(nonlinearity_realisations(), output / "nonlinearity" / "runs", solver)
    scores = NonlinearityScores.of(scored)
    print(scores.write(output / "nonlinearity"))
    if not _rewrite_report(output):
        scores.draw(output / "nonlinearity")
    return 1 if scored.missing else 0


def _rewrite_report(output: Path) -> bool:
    """Whether there is a report with what has been added: it is written from runs that are all there."""
    planned = planned_runs()
    runs = read_runs(planned, output / "runs")
    if len(runs) < len(planned):
        print(f"{output / 'report.html'} waits for runs that are missing or out of date: `make paper` makes them")
        return False
    print(write_report(runs, [], output))
    return True


if __name__ == "__main__":
    sys.exit(main())
