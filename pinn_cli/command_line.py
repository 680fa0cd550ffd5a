"""The command `pinn-run`: Hydra's command line, with one line per error and an exit status for shell scripts.

    0  done
    1  a defect of the program: its traceback
    2  input that no run can use: one line that says which setting, why and what to do
    3  a run that diverged: one line that says where
    130  interrupted by Ctrl-C (SIGINT); pinn-run resume=DIRECTORY goes on
    143  the same by SIGTERM
    141  nobody reads the output any more

`HYDRA_FULL_ERROR=1` adds the traceback to 2 and 3.
"""

from __future__ import annotations

import logging
import math
import os
import sys
import textwrap
import traceback
from argparse import Namespace
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from pinn_cli import run_directories
from pinn_cli.command_options import read_options
from pinn_cli.errors import DivergenceError, InputError
from pinn_cli.interruption import Interruption, watched
from pinn_cli.override_errors import explain
from pinn_cli.resume import StoredRun, resume_command

log = logging.getLogger(__name__)

Task = Callable[[DictConfig], float | None]

STATUS_INPUT, STATUS_DIVERGED, STATUS_INTERRUPTED, STATUS_PIPE = 2, 3, 130, 141
HELP_WIDTH = 120


class Jobs:
    """The task as Hydra calls it, once per job, and what became of the jobs.

    An error that the user can mend is reported at once and does not reach Hydra, which would print a line of its own
    and leave the other jobs of a sweep without their tables.
    """

    def __init__(self, task: Task, full_error: bool) -> None:
        self.task, self.full_error = task, full_error
        self.started = False
        self.status = 0
        self.unusable: list[Path] = []
        self.stored: StoredRun | None = None
        self.directory: Path | None = None
        self._process = os.getpid()

    def __call__(self, config: DictConfig) -> float | None:
        """Run one job; see the class. What it returns reaches Hydra's sweeper: a score, or None where there is none."""
        self.started = True
        self.directory = Path(HydraConfig.get().runtime.output_dir)
        try:
            return self.task(config if self.stored is None else self.stored.configuration(config))
        except (InputError, DivergenceError) as error:
            if os.getpid() != self._process:  # a launcher's worker: only Hydra can carry the failure back
                raise
            if isinstance(error, InputError):
                self.unusable.append(self.directory)
            log.info("%s", error)
            self.report(error)
        return None

    def report(self, error: InputError | DivergenceError) -> None:
        """Print the error's one line and note the exit status that it asks for."""
        if self.full_error:
            traceback.print_exception(error)
        else:
            print(f"pinn-run: {' '.join(str(error).split())}", file=sys.stderr)
        self.status = max(self.status, STATUS_INPUT if isinstance(error, InputError) else STATUS_DIVERGED)


def execute(task: Task) -> int:
    """Run a task under the command line that the process was started with.

    Args:
        task: Called with the composed configuration, without its `hydra` node; once per job of a sweep.

    Returns:
        The exit status, as listed at the top of this file.
    """
    jobs = Jobs(task, full_error=os.environ.get("HYDRA_FULL_ERROR") == "1")
    options = Namespace(overrides=[], config_dir=None)
    refused = False
    try:
        options = read_options(sys.argv)
        with watched():
            if options.help:
                _print_help(jobs)
            elif not _has_finished(jobs, options):
                _run_hydra(jobs)
    except KeyboardInterrupt as stop:
        goes_on = f"; to go on: {resume_command(jobs.directory)}" if jobs.directory else ""
        print(f"pinn-run: interrupted{goes_on}", file=sys.stderr)
        return stop.status if isinstance(stop, Interruption) else STATUS_INTERRUPTED
    except BrokenPipeError:  # the reader has left, as in `pinn-run --help | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return STATUS_PIPE
    except Exception as error:
        explained = explain(error, options.overrides, options.config_dir, composing=not jobs.started)
        if explained is None:
            raise
        jobs.report(explained.with_traceback(error.__traceback__))
        refused = True
    finally:
        if refused or jobs.unusable:
            run_directories.discard(jobs.unusable)
    return jobs.status


def _has_finished(jobs: Jobs, options: Namespace) -> bool:
    """Have a run that is named by `resume=DIRECTORY` go on, unless it has all its results: that is said in one line."""
    jobs.stored = StoredRun.asked_for(options)
    if jobs.stored is None:
        return False
    if jobs.stored.finished():
        print(f"finished before, nothing to do\n{jobs.stored.directory}")
        return True
    sys.argv[1:] = jobs.stored.arguments
    jobs.stored.enter()
    return False


def scored(result: float | None) -> float | None:
    """A job's score as a sweeper may see it: hydra-optuna-sweeper 1.3.0 takes None for a failure and dies of NaN."""
    return result if result is not None and math.isfinite(result) else None


def _print_help(jobs: Jobs) -> None:
    """Hydra's help, which has every option of a group in one line, with long lines folded."""
    text = StringIO()
    try:
        with redirect_stdout(text):
            _run_hydra(jobs)
    finally:  # Hydra exits once it has printed its help
        for line in text.getvalue().splitlines():
            folded = textwrap.wrap(line, HELP_WIDTH, subsequent_indent=" " * 4, break_on_hyphens=False)
            print("\n".join(folded) if len(line) > HELP_WIDTH else line)


def _run_hydra(jobs: Jobs) -> None:
    def run_job(config: DictConfig) -> float | None:
        return scored(jobs(config))

    given = os.environ.get("HYDRA_FULL_ERROR")
    os.environ["HYDRA_FULL_ERROR"] = "1"  # so that Hydra raises, rather than prints and exits with status 1
    try:
        hydra.main(version_base="1.3", config_path="pkg://pinn_cli.conf", config_name="config")(run_job)()
    finally:
        del os.environ["HYDRA_FULL_ERROR"]
        os.environ.update({} if given is None else {"HYDRA_FULL_ERROR": given})
