"""`pinn-run`: config, system, record, problem, estimate (its posterior, a baseline's), report, in this order."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from pinn_cli.cli.command_line import execute
from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.prepare import prepare_problem
from pinn_cli.runs.identity import flattened
from pinn_cli.runs.resume import RESULT, asked_to_resume, check_sound, is_finished, stored_score
from pinn_cli.runs.signs_of_life import signs_of_life
from pinn_cli.runs.stages import Stages
from pinn_cli.runs.tracking_state import is_tracked

if TYPE_CHECKING:
    from pinn_cli.record.record import Response
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import Watch


def run(composed: DictConfig) -> float | None:
    """Run one job, or go on with it: what it leaves behind lies in Hydra's run directory, the last line printed.

    Returns:
        Its validation score, for a sweeper that looks for the least; None without one.
    """
    runtime = HydraConfig.get().runtime
    directory, base, stages = Path(runtime.output_dir), Path(runtime.cwd), Stages()
    in_sweep = HydraConfig.get().mode == RunMode.MULTIRUN  # which shows its progress, and its tables at its end
    with stages("config"):
        resuming = asked_to_resume(composed, directory)
        finished = resuming and is_finished(directory, composed, base)
        config = None if finished and is_tracked(directory, composed) else RunConfig.read(composed, base)
    if config is None:
        if not in_sweep:
            print(f"finished before, nothing to do\n{directory}")
        return _judged(composed, directory)
    with stages("imports"):  # after the configuration has limited the threads, and not for --help
        from pinn_cli.tracking.base import TrackedRun
        from pinn_cli.tracking.follow import follow
    name, which = f"{config.case}/{directory.name}", config.identity.configuration
    tracked_run = TrackedRun(directory, name, flattened(composed), config.description.labels_of("pinn"), which)
    telling = nullcontext() if in_sweep else signs_of_life(stages)
    with telling, follow(config.tracking, tracked_run, resuming) as tracked:
        if finished:
            text = f"finished before; tracking={config.tracking.name} has it now"
        else:
            text = _carry_out(config, directory, stages, in_sweep, tracked.row)
        with stages("tracking"):
            tracked.results()
    if not in_sweep:
        print(f"{text}\n{directory}")
    return _judged(composed, directory)


def _judged(composed: DictConfig, directory: Path) -> float | None:
    """The score of a finished run, whose verdict must be sound with ``strict=true``."""
    if composed.get("strict") is True:
        check_sound(directory)
    return stored_score(directory)


def _carry_out(config: RunConfig, directory: Path, stages: Stages, in_sweep: bool, watch: Watch) -> str:
    """From the system to the report, which it returns as text."""
    with stages("imports"):
        from pinn_cli.baseline.comparison import baseline_estimate
        from pinn_cli.posterior.result import posterior_result
        from pinn_cli.report.results import Results
        from pinn_cli.report.run_report import write_report
        from pinn_cli.runs.run_checkpoints import open_checkpoints
        from pinn_cli.training.estimate import RunContext
        from pinn_cli.validation.base import Setup
    prepared = prepare_problem(config, stages)
    prescribed, problem = prepared.prescribed, prepared.problem
    with stages("estimate"):
        (directory / RESULT).unlink(missing_ok=True)  # an earlier run's, whose files are replaced from here on
        checkpoints = open_checkpoints(
            directory, config.identity, config.resume, config.checkpoint_every_s, config.device
        )
        context = RunContext(config.device, config.seed, directory, sys.stderr.isatty() and not in_sweep, checkpoints)
        setup = Setup(prescribed, config.scheme, config.estimator, context)
        config.validation.check(problem, setup)
        estimate = config.estimator.solve(problem, replace(context, watch=watch))
    with stages("posterior"):
        posterior = posterior_result(config.posterior, problem, estimate, context)
    with stages("validation"):
        score = config.validation.score(problem, estimate, setup)
    with stages("baseline"):
        baseline = baseline_estimate(config.baseline, problem, context)
    drawn = config.figures if config.figures is not None else not in_sweep
    linear = _linear_response(config, prepared.true) if drawn else None
    results = Results(
        config.description,
        prescribed,
        prepared.record,
        prepared.truth,
        estimate,
        baseline,
        posterior,
        score,
        problem,
        linear,
    )
    return write_report(results, directory, stages, drawn)


def _linear_response(config: RunConfig, true: Structure) -> Response | None:
    """See :attr:`pinn_cli.report.results.Results.linear_response`."""
    if not config.source.simulated or config.model_error.name != "linear":
        return None
    return config.source.measure(true.linearised()).truth.response


def main() -> None:
    """The command: exits with the status listed in `pinn_cli.cli.command_line`."""
    sys.exit(execute(run))


if __name__ == "__main__":
    main()
