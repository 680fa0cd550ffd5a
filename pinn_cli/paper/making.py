"""What ``make paper``, ``figures``, ``seeds`` and ``nonlinearity`` do: what is missing, then what is written of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.paper.figure_list import PAPER_FIGURES
from pinn_cli.paper.plan import planned_runs
from pinn_cli.paper.runs import make_runs, read_runs
from pinn_cli.report.run_record import package_versions

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from pinn_cli.paper.runs import FinishedRun, Runner
    from pinn_cli.paper.study.job import Job, JobResult

    Solver = Callable[[Job], JobResult]

REPORT, SEEDS, NONLINEARITY = "report.html", "seeds", "nonlinearity"


def make_paper(output: Path, runner: Runner | None = None) -> int:
    """Make the runs that are missing, then tables, figures and report.

    Args:
        output: Folder of all of it; the runs lie in ``<output>/runs``.
        runner: Makes a run; None: `pinn-run` in a process of its own.

    Returns:
        0, or 1 if a run failed: what could be made without it is there nevertheless.
    """
    runs, failures = _runs(output, None, runner)
    _draw(runs, output)
    _write(runs, failures, output)
    return 1 if failures else 0


def make_figures(output: Path, runner: Runner | None = None) -> int:
    """Make the runs that a figure is drawn from, where they are missing, and draw the figures; as `make_paper`."""
    runs, failures = _runs(output, {figure.run for figure in PAPER_FIGURES}, runner)
    _draw(runs, output)
    print(output / "figures")
    return 1 if failures else 0


def make_seeds(output: Path, solver: Solver | None = None) -> int:
    """Solve the cases of Tables 2 and 5 over the noise seeds, where that is missing; rewrite the report.

    Args:
        output: As of `make_paper`; the results lie in ``<output>/seeds``.
        solver: Solves one job; None: network and smoother, in this process.

    Returns:
        0, or 1 if a job failed.
    """
    from pinn_cli.paper.study.noise_seeds import make_seed_study

    study = make_seed_study(output / SEEDS, **({"solver": solver} if solver else {}))
    print(output / SEEDS / "summary.csv")
    _rewrite(output)
    return 1 if study.results.failures or study.results.missing else 0


def make_nonlinearity(output: Path, solver: Solver | None = None) -> int:
    """The same of the study of nonlinearity, in ``<output>/nonlinearity``; a training that diverges is a finding."""
    from pinn_cli.paper.study.nonlinearity import make_nonlinearity_study

    study = make_nonlinearity_study(output / NONLINEARITY, **({"solver": solver} if solver else {}))
    print(output / NONLINEARITY / "nonlinearity.csv")
    _rewrite(output)
    return 1 if study.results.missing else 0


def make_all(output: Path) -> int:
    """The paper, the seeds and the nonlinearity; the largest of their statuses."""
    return max([make(output) for make in (make_paper, make_seeds, make_nonlinearity)])


def _runs(output: Path, names: set[str] | None, runner: Runner | None) -> tuple[list[FinishedRun], list[str]]:
    planned = [run for run in planned_runs() if names is None or run.name in names]
    return make_runs(planned, output / "runs", **({"runner": runner} if runner else {}))


def _draw(runs: Sequence[FinishedRun], output: Path) -> None:
    # pandas, torch and matplotlib are wanted once the runs are there: --help need not wait for them.
    from pinn_cli.paper.figures import draw_figures

    draw_figures({run.planned.name: run.directory for run in runs}, output / "figures")


def _rewrite(output: Path) -> None:
    """The report with what has been added to it, from runs that are all there; without them nothing is written."""
    runs = read_runs(planned_runs(), output / "runs")
    if len(runs) < len(planned_runs()):
        print(f"{output / REPORT} waits for runs that are missing or out of date: `make paper` makes them")
        return
    _write(runs, [], output)


def _write(runs: Sequence[FinishedRun], failures: Sequence[str], output: Path) -> None:
    from pinn_cli.paper.report import ReportContent, write_report
    from pinn_cli.paper.study.noise_seeds import read_seed_study
    from pinn_cli.paper.study.nonlinearity import read_nonlinearity_study, write_nonlinearity_figure
    from pinn_cli.paper.study.seeds_sheet import seed_sheets
    from pinn_cli.paper.tables import paper_tables, write_sheets, write_tables

    tables = paper_tables(runs)
    write_tables(tables, output / "tables")
    seeds = read_seed_study(output / SEEDS)
    write_sheets(seed_sheets(seeds), output / SEEDS)
    nonlinearity = read_nonlinearity_study(output / NONLINEARITY)
    drawn = write_nonlinearity_figure(nonlinearity, output / NONLINEARITY)
    made = {run.planned.name for run in runs}
    images = {figure.number: output / "figures" / f"{figure.name}.png" for figure in PAPER_FIGURES
              if not figure.run or figure.run in made}  # fmt: skip
    there = {number: place for number, place in images.items() if place.exists()}
    content = ReportContent(
        runs, failures, tables, PAPER_FIGURES, there, package_versions(), seeds, nonlinearity, drawn
    )
    print(write_report(content, output / REPORT))
