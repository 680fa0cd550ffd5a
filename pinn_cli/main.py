"""`pinn-run`: config, system, record, problem, estimate (its posterior, a baseline's), report, in this order.

The first four are a job's input, which is read and checked before anything is written (:mod:`pinn_cli.cli.job`).
"""

from __future__ import annotations

import sys
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from omegaconf import DictConfig

from pinn_cli import LOADED
from pinn_cli.cli.command_line import Task, execute
from pinn_cli.cli.inspecting import LOOKED_AT
from pinn_cli.cli.job import Job, Start, look_and_tell, results_of, run_job, shown
from pinn_cli.cli.terminal import Terminal
from pinn_cli.runs.claim import current
from pinn_cli.runs.process import is_borrowed, keep_imported

if TYPE_CHECKING:
    from pinn_cli.training.estimate import Watch


def carry_out(job: Job, watch: Watch) -> None:
    """From a job's problem to its report, whose text is printed before its files are written."""
    config, stages, problem = job.config, job.start.stages, job.prepared.problem
    with stages("imports"):
        from pinn_cli.baseline import baseline_estimate
        from pinn_cli.posterior.posterior import posterior_result
        from pinn_cli.report.run_report import RunReport
    if not is_borrowed():
        keep_imported()
    with stages("estimate"):
        estimate = config.estimator.solve(problem, replace(job.context, watch=watch))
    problem = problem if estimate.structure is None else problem.in_basis_of(estimate.structure)
    current().settle()
    with stages("posterior"):
        posterior = posterior_result(config.posterior, problem, estimate, job.context)
    with stages("validation"):
        score = config.validation.score(problem, estimate, job.setup)
    with stages("baseline"):
        baseline = baseline_estimate(config.baseline, problem, job.context)
    results = results_of(job, problem, estimate, posterior=posterior, score=score, baseline=baseline)
    report = RunReport(results, job.start.directory, stages, config.exports)
    with report.drawing() if job.draws else nullcontext(), shown(report.text, stages, job.start.terminal):
        report.write()


def run(
    composed: DictConfig, began: float | None = None, terminal: Terminal | None = None, follows: bool = False
) -> float | None:
    """Run one job, or go on with it; arguments as of :class:`pinn_cli.cli.job.Start`, value as of `run_job`."""
    return run_job(Start(composed, began, terminal, follows), carry_out)


# What a word on the command line asks for in place of a run.
TASKS: dict[str, Task] = {
    "follow": partial(run, follows=True),
    **{word: partial(look_and_tell, word) for word in LOOKED_AT},
}


def main() -> None:
    """The command: exits with the status listed in `pinn_cli.cli.command_line`."""
    start = partial(run, began=LOADED)
    sys.exit(execute(start, TASKS | {"follow": partial(start, follows=True)}))


if __name__ == "__main__":
    main()
