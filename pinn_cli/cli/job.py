"""One job: its input is checked, it takes its directory or goes on there, and is carried out under its tracker."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.inspecting import LOOKED_AT
from pinn_cli.cli.prepare import check_records, prepare_problem, prepare_windows
from pinn_cli.cli.terminal import SILENCE, Terminal
from pinn_cli.runs import resume
from pinn_cli.runs.claim import current
from pinn_cli.runs.identity import flattened
from pinn_cli.runs.process import collect_rarely, is_borrowed
from pinn_cli.runs.stages import Stages, signs_of_life
from pinn_cli.settings.override_syntax import quoted
from pinn_cli.settings.yaml_file import SCHEME

if TYPE_CHECKING:
    from pinn_cli.cli.prepare import PreparedProblem
    from pinn_cli.inspection.report import LookReport
    from pinn_cli.report.results import Results
    from pinn_cli.scheme.joint_problem import JointProblem
    from pinn_cli.sweep.windowed_run import WindowedRun
    from pinn_cli.training.estimate import Estimate, RunContext, Watch
    from pinn_cli.validation.validation import Setup


@dataclass(frozen=True)
class Job:
    """A run whose input has been found good.

    Attributes:
        start: Where and how it runs.
        config: Its settings.
        prepared: What it solves, and what that is scored against.
        context: What its estimators are given.
        setup: Of its validation.
        draws: Whether there are figures.
    """

    start: Start
    config: RunConfig
    prepared: PreparedProblem
    context: RunContext
    setup: Setup
    draws: bool


class Start:
    """A job as Hydra starts it, whose input is yet to be checked.

    Args:
        composed: Its configuration.
        began: When the process of a single run did, by `time.perf_counter`; None: it is counted from now.
        terminal: Where a single run tells what it has found; None: standard output.
        follows: Whether its record may still grow; it goes on with the windows that are there.
    """

    def __init__(self, composed: DictConfig, began: float | None, terminal: Terminal | None, follows: bool) -> None:
        hydra = HydraConfig.get()
        self.composed, self.follows = composed, follows
        self.directory, self.base = Path(hydra.runtime.output_dir), Path(hydra.runtime.cwd)
        # Which shows its progress, and its tables at its end.
        self.in_sweep = hydra.mode == RunMode.MULTIRUN
        self.terminal = SILENCE if self.in_sweep else terminal or Terminal()
        self.stages, self.resumes = Stages(None if self.in_sweep else began), False

    def finished(self) -> tuple[bool, bool]:
        """Whether it is to go on and has finished, and whether its tracker has it too."""
        ended = self.resumes and resume.is_finished(self.directory, self.composed, self.base)
        return ended, ended and resume.is_tracked(self.directory, self.composed)

    def prepared(self, config: RunConfig) -> Job | WindowedRun:
        """Everything that may find fault with the input; nothing is written."""
        stages, terminal, directory = self.stages, self.terminal, self.directory
        with stages("imports"):
            from pinn_cli.report.parameters import history
            from pinn_cli.report.results import checked_times
            from pinn_cli.runs.checkpoint import open_checkpoints
            from pinn_cli.training.estimate import RunContext
            from pinn_cli.validation.validation import Setup
        progress = terminal.bar and sys.stderr.isatty() and not self.in_sweep
        context = RunContext(config.device, config.seed, directory, progress=progress)
        draws = not self.in_sweep if config.figures is None else config.figures
        if config.source.windows is not None:
            return prepare_windows(
                config, context, stages, terminal.say, goes_on=self.resumes, drawn=draws, follows=self.follows
            )
        if config.scheme.looks_for_changes and config.model is not None:
            history(config.model)  # which goes on behind this run
        prepared = prepare_problem(config, stages)
        every_s = config.checkpoint_every_s
        checkpoints = open_checkpoints(directory, config.identity, config.resume, every_s, config.device)
        context = replace(context, checkpoints=checkpoints)
        setup = Setup(prepared.prescribed, config.scheme, config.estimator, context)
        for problem in prepared.problem:
            for estimator in (config.estimator, *([config.baseline] if config.baseline else [])):
                estimator.check(problem)
            if prepared.problem.priors:
                config.posterior.check(problem)
            if config.between is not None:
                checked_times("report.between", config.between, problem.record.time)
        check_records(prepared.problem, config.estimator, config.baseline, config.validation)
        config.validation.check(prepared.problem, setup)
        return Job(self, config, prepared, context, setup, draws)

    def tracked(
        self, config: RunConfig, prepared: Job | WindowedRun | None, carry_out: Callable[[Job, Watch], None]
    ) -> str:
        """Make the run, or tell of one that had finished, under the eyes of its tracker; what is left to print."""
        with self.stages("imports"):  # after the configuration has limited the threads, and not for --help
            from pinn_cli.sweep.tracking.tracking import TrackedRun, follow
        name, which = f"{config.case}/{self.directory.name}", config.identity.configuration
        labels = config.description.labels_of("pinn")
        run = TrackedRun(self.directory, name, flattened(self.composed), labels, which)
        with follow(config.tracking, run, self.resumes) as tracked:
            text = ""
            if prepared is None:
                current().take()
                text = f"finished before; tracking={tracked.state.tracking} has it now"
            elif isinstance(prepared, Job):
                checkpoints = prepared.context.checkpoints
                unused = () if checkpoints is None or checkpoints.taken_up else resume.CHECKPOINTS
                current().take([resume.RESULT, *unused])
                carry_out(prepared, tracked.row)
            else:
                current().take([resume.RESULT])
                current().settle()
                text = prepared.carry_out(self.stages, tracked.row)
            with self.stages("tracking"):
                tracked.results()
        return text


def run_job(start: Start, carry_out: Callable[[Job, Watch], None]) -> float | None:
    """Run one job, or go on with it: what it leaves behind lies in Hydra's run directory, the last line printed.

    Its input is checked before it takes the directory (:mod:`pinn_cli.runs.claim`); until then it writes nothing.

    Returns:
        Its validation score, for a sweeper that looks for the least; None without one.

    Raises:
        InputError: No run can use its settings.
        NotSoundError: Its verdict is not sound, with ``strict=true``.
    """
    composed, directory = start.composed, start.directory
    if not is_borrowed():
        collect_rarely()
    with start.stages("config"):
        start.resumes = resume.asked_to_resume(composed, directory)
        ended, done = start.finished()
        config = None if done else RunConfig.read(composed, start.base, start.follows)
    if config is not None:
        current().lock()
        ended, done = start.finished()  # by the process that was in there
    if config is None or done:
        current().untouched = True
        text = "finished before, nothing to do"
    else:
        with nullcontext() if start.in_sweep or start.follows else signs_of_life(start.stages):
            text = start.tracked(config, None if ended else start.prepared(config), carry_out)
    if text:
        start.terminal.say(text)
    start.terminal.conclude(directory)
    if composed.get("strict") is True:
        resume.check_sound(directory)
    return resume.stored_score(directory)


@contextmanager
def shown(text: Callable[[], str], stages: Stages, terminal: Terminal) -> Iterator[None]:
    """Print before the block, if anybody listens.

    A reader that has left is told of after the block, so that the block's files are written.
    """
    if terminal.last is None:
        yield
        return
    refused = None
    try:
        terminal.say(text())
    except OSError as error:
        refused = error
    stages.reached("table_at")
    yield
    if refused is not None:
        raise refused


def results_of(job: Job, problem: JointProblem, estimate: Estimate, **more: Any) -> Results:
    """All that a run has found, of every record, with its posterior, score and baseline.

    The problem is the one that was solved, in the coordinates of its solution.
    """
    from pinn_cli.report.results import Results, checked_times, further_results, in_functions_of
    from pinn_cli.system.basis import in_basis_of
    from pinn_cli.training.calibrated_record import as_calibrated

    config, prepared = job.config, job.prepared
    record = as_calibrated(prepared.record, estimate.by_record[0])
    prescribed, truths = prepared.prescribed, prepared.truths
    if estimate.structure is not None:
        prescribed = in_basis_of(prescribed, estimate.structure)
        truths = tuple(in_functions_of(truth, prepared.true, estimate.structure) for truth in truths)
    linear = None  # what the paper's figure of a linear model compares with
    if job.draws and config.source.simulated and config.model_error.name == "linear":
        linear = config.source.measure(prepared.true.linearised()).truth.response
    results = Results(
        config.description,
        prescribed,
        record,
        truths[0],
        estimate,
        problem=None if config.scheme.predicts else replace(problem.first, record=record),  # there is nothing to judge
        linear_response=linear,
        true=prepared.true if config.source.simulated else None,
        validation=prepared.validation,
        model=config.model,
        shown=None if config.between is None else checked_times("report.between", config.between, record.time),
        **more,
    )
    return replace(results, further=further_results(results, problem.by_record[1:], truths[1:]))


def look_and_tell(word: str, composed: DictConfig, terminal: Terminal | None = None) -> None:
    """`pinn-run inspect`, `modes` and `population`: look, leave tables and figures, and print the tables."""
    report, terminal = look(word, composed), terminal or Terminal()
    directory = leave(report, composed)
    terminal.say(report.text())
    terminal.conclude(directory)


def look(word: str, composed: DictConfig) -> LookReport:
    """What a look finds, which this word on the command line asks for; nothing is written.

    Records that cannot be read, and runs that are none, are refused.
    """
    hydra, stages = HydraConfig.get(), Stages()
    runtime = hydra.runtime
    with signs_of_life(stages):
        with stages("imports"):
            from pinn_cli.inspection.proposal import Said
        with stages("inspection"):
            said = Said(list(hydra.overrides.task), _folders(runtime), chosen=dict(runtime.choices))
            return LOOKED_AT[word](composed, Path(runtime.cwd), said)


def leave(report: LookReport, composed: DictConfig) -> Path:
    """Write what a look has found into the job's directory, and return that."""
    directory = Path(HydraConfig.get().runtime.output_dir)
    current().lock()
    current().take()
    report.write(directory, composed.get("figures") is not False)
    return directory


def _folders(runtime: Any) -> list[str]:
    """The options that have the same folders of configurations searched."""
    folders = [Path(source.path) for source in runtime.config_sources if source.schema == SCHEME]
    here = Path(runtime.cwd)
    first, *others = [
        str(folder.relative_to(here) if folder.is_relative_to(here) else folder) for folder in folders
    ] or [""]
    further = [f"hydra.searchpath=[{','.join(quoted(f'file://{other}') for other in others)}]"] if others else []
    return ["--config-dir", first, *further] if folders else []
