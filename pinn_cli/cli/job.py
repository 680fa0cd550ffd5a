"""One job: its input is checked, it takes its directory or goes on there, and is carried out under its tracker."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.inspecting import Inspected
from pinn_cli.cli.records import check_records
from pinn_cli.cli.terminal import Silence, Terminal
from pinn_cli.cli.windows import windowed_run
from pinn_cli.runs.claim import leave_directory, lock_directory, settle_directory, take_directory
from pinn_cli.runs.identity import flattened
from pinn_cli.runs.memory import collect_rarely
from pinn_cli.runs.process import is_borrowed
from pinn_cli.runs.resume import RESULT, asked_to_resume, check_sound, is_finished, stored_score
from pinn_cli.runs.stages import Stages, signs_of_life
from pinn_cli.runs.tracking_state import is_tracked

if TYPE_CHECKING:
    from pinn_cli.cli.prepare import PreparedProblem
    from pinn_cli.record.response import Response
    from pinn_cli.report.results import Results
    from pinn_cli.scheme.joint_problem import JointProblem
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import Estimate, RunContext, Watch
    from pinn_cli.validation.base import Setup
    from pinn_cli.windows.run import WindowedRun


def run_job(
    composed: DictConfig,
    began: float | None,
    terminal: Terminal | None,
    follows: bool,
    carry_out: Callable[[Job, Watch], None],
) -> float | None:
    """Run one job, or go on with it: what it leaves behind lies in Hydra's run directory, the last line printed.

    Its input is checked before it takes the directory (:mod:`pinn_cli.runs.claim`); until then it writes nothing.

    Args:
        composed: Its configuration.
        began: When the process of a single run did, by `time.perf_counter`; None: it is counted from now.
        terminal: Where a single run tells what it has found; None: standard output.
        follows: Whether its record may still grow; it goes on with the windows that are there.
        carry_out: From the prepared problem to the report.

    Returns:
        Its validation score, for a sweeper that looks for the least; None without one.
    """
    runtime = HydraConfig.get().runtime
    in_sweep = HydraConfig.get().mode == RunMode.MULTIRUN  # which shows its progress, and its tables at its end
    terminal = Silence() if in_sweep else terminal or Terminal()
    directory, base, stages = Path(runtime.output_dir), Path(runtime.cwd), Stages(None if in_sweep else began)
    if not is_borrowed():
        collect_rarely()
    with stages("config"):
        resuming = asked_to_resume(composed, directory)
        config = None if _is_done(resuming, composed, directory, base) else RunConfig.read(composed, base, follows)
    if config is not None:
        lock_directory()
    if config is None or _is_done(resuming, composed, directory, base):  # by the process that was in there
        leave_directory()
        return _judged(composed, directory, "finished before, nothing to do", terminal)
    finished = resuming and is_finished(directory, composed, base)
    with nullcontext() if in_sweep or follows else signs_of_life(stages):
        how = resuming, in_sweep, follows
        prepared = None if finished else _prepare(config, directory, stages, how, terminal)
        text = _tracked(config, composed, stages, resuming, prepared, carry_out)
    return _judged(composed, directory, text, terminal)


def inspect(composed: DictConfig) -> None:
    """Look at a record before anything is estimated: a table, a figure and a command to go on with."""
    runtime = HydraConfig.get().runtime
    directory, base = Path(runtime.output_dir), Path(runtime.cwd)
    stages = Stages()
    with signs_of_life(stages):
        with stages("record"):
            inspected = Inspected.read(composed, base)
        with stages("imports"):
            from pinn_cli.inspection.inspection import inspect_record
            from pinn_cli.inspection.report import write_inspection
        with stages("inspection"):
            overrides = list(HydraConfig.get().overrides.task)
            found = inspect_record(
                inspected.signals, inspected.time, overrides, inspected.frequencies, inspected.measured
            )
        lock_directory()
        take_directory()
        with stages("report"):
            text = write_inspection(found, directory, composed.get("figures") is not False)
    Terminal().say(f"{text}\n{directory}")


def _tracked(
    config: RunConfig,
    composed: DictConfig,
    stages: Stages,
    resuming: bool,
    prepared: Job | WindowedRun | None,
    carry_out: Callable[[Job, Watch], None],
) -> str:
    """Make the run, or tell of one that had finished, under the eyes of its tracker; what is left to print."""
    directory = Path(HydraConfig.get().runtime.output_dir)
    with stages("imports"):  # after the configuration has limited the threads, and not for --help
        from pinn_cli.tracking.base import TrackedRun
        from pinn_cli.tracking.follow import follow
    name, which = f"{config.case}/{directory.name}", config.identity.configuration
    tracked_run = TrackedRun(directory, name, flattened(composed), config.description.labels_of("pinn"), which)
    with follow(config.tracking, tracked_run, resuming) as tracked:
        take_directory(_outdated(prepared))
        text = f"finished before; tracking={config.tracking.name} has it now" if prepared is None else ""
        if isinstance(prepared, Job):
            carry_out(prepared, tracked.row)
        elif prepared is not None:
            settle_directory()
            text = prepared.carry_out(stages, tracked.row)
        with stages("tracking"):
            tracked.results()
    return text


def _is_done(resuming: bool, composed: DictConfig, directory: Path, base: Path) -> bool:
    """Whether there is nothing to do, the tracker included."""
    return resuming and is_finished(directory, composed, base) and is_tracked(directory, composed)


def _judged(composed: DictConfig, directory: Path, text: str, terminal: Terminal) -> float | None:
    """Tell how it ended; the score of a finished run, whose verdict must be sound with ``strict=true``."""
    terminal.say(f"{text}\n{directory}" if text else str(directory))
    if composed.get("strict") is True:
        check_sound(directory)
    return stored_score(directory)


@dataclass(frozen=True)
class Job:
    """A run whose input has been found good.

    Attributes:
        config: Its settings.
        prepared: What it solves, and what that is scored against.
        context: What its estimators are given.
        setup: Of its validation.
        directory: Where it leaves what it finds.
        stages: Their seconds.
        terminal: Who is told.
        in_sweep: Whether it is a job of a sweep.
    """

    config: RunConfig
    prepared: PreparedProblem
    context: RunContext
    setup: Setup
    directory: Path
    stages: Stages
    terminal: Terminal
    in_sweep: bool

    @property
    def draws(self) -> bool:
        """Whether there are figures."""
        return self.config.draws(self.in_sweep)


def _prepare(
    config: RunConfig, directory: Path, stages: Stages, how: tuple[bool, bool, bool], terminal: Terminal
) -> Job | WindowedRun:
    """Everything that may find fault with the input; nothing is written.

    Args:
        config: Of the run.
        directory: Of it.
        stages: Likewise.
        how: Whether it goes on, is a job of a sweep, and follows its record.
        terminal: Who is told.

    Raises:
        InputError: No run can use it.
    """
    with stages("imports"):
        from pinn_cli.cli.prepare import prepare_problem
        from pinn_cli.report.parameters import history
        from pinn_cli.runs.checkpoint import open_checkpoints
        from pinn_cli.training.estimate import RunContext
        from pinn_cli.validation.base import Setup
    goes_on, in_sweep, follows = how
    progress = sys.stderr.isatty() and not in_sweep
    if config.source.windows is not None:
        context = RunContext(config.device, config.seed, directory, progress)
        say = partial(_told, terminal)
        return windowed_run(
            config, directory, context, stages, goes_on=goes_on, drawn=config.draws(in_sweep), say=say, follows=follows
        )  # fmt: skip
    if config.scheme.looks_for_changes and config.model is not None:
        history(config.model)  # which goes on behind this run
    prepared = prepare_problem(config, stages)
    checkpoints = open_checkpoints(directory, config.identity, config.resume, config.checkpoint_every_s, config.device)
    context = RunContext(config.device, config.seed, directory, progress, checkpoints)
    setup = Setup(prepared.prescribed, config.scheme, config.estimator, context)
    for estimator in (config.estimator, *([config.baseline] if config.baseline else [])):
        for problem in prepared.problem:
            estimator.check(problem)
    for problem in prepared.problem if prepared.problem.priors else ():
        config.posterior.check(problem)
    check_records(prepared.problem, config.estimator, config.baseline, config.validation)
    config.validation.check(prepared.problem, setup)
    return Job(config, prepared, context, setup, directory, stages, terminal, in_sweep)


def _told(terminal: Terminal, line: str) -> None:
    """Say a line at once: what follows it may take long."""
    terminal.say(line)
    sys.stdout.flush()


def _outdated(prepared: Job | WindowedRun | None) -> list[str]:
    """Files of an earlier run whose place this one takes: its result, and checkpoints that it does not go on from."""
    if not isinstance(prepared, Job):
        return [] if prepared is None else [RESULT]
    checkpoints = prepared.context.checkpoints
    return [RESULT, *([] if checkpoints is None or checkpoints.taken_up else checkpoints.files.NAMES)]


@contextmanager
def shown(text: str, stages: Stages, terminal: Terminal) -> Iterator[None]:
    """Print before the block; a reader that has left is told of after it, so that the block's files are written."""
    refused = None
    try:
        terminal.say(text)
        sys.stdout.flush()
    except OSError as error:
        refused = error
    stages.reached("table_at")
    yield
    if refused is not None:
        raise refused


def results_of(job: Job, problem: JointProblem, estimate: Estimate, **more: Any) -> Results:
    """All that a run has found, of every record.

    Args:
        job: The run.
        problem: That was solved, in the coordinates of its solution.
        estimate: Of it.
        more: Posterior, score and baseline.
    """
    from pinn_cli.report.results import Results, further_results
    from pinn_cli.training.calibrated_record import as_calibrated

    config, prepared = job.config, job.prepared
    record, prescribed = as_calibrated(prepared.record, estimate.by_record[0]), prepared.prescribed
    results = Results(
        config.description,
        prescribed if estimate.structure is None else prescribed.in_coordinates_of(estimate.structure),
        record,
        prepared.truth,
        estimate,
        problem=None if config.scheme.predicts else replace(problem.first, record=record),  # there is nothing to judge
        linear_response=_linear_response(config, prepared.true) if job.draws else None,
        true=prepared.true if config.source.simulated else None,
        validation=prepared.validation,
        model=config.model,
        **more,
    )
    return replace(results, further=further_results(results, problem.each[1:], prepared.truths[1:]))


def _linear_response(config: RunConfig, true: Structure) -> Response | None:
    """See :attr:`pinn_cli.report.results.Results.linear_response`."""
    if not config.source.simulated or config.model_error.name != "linear":
        return None
    return config.source.measure(true.linearised()).truth.response
