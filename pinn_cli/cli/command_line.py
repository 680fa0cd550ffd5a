"""The command `pinn-run`: Hydra's command line, with one line per error and an exit status for shell scripts.

    0  done
    1  a defect of the program: its traceback
    2  input that no run can use: one line that says which setting, why and what to do
    3  a run that diverged, or whose files the disk does not take: one line that says where
    4  with strict=true, a run whose verdict is not sound: its results are written, and one line says why
    130  interrupted by Ctrl-C (SIGINT); pinn-run resume=DIRECTORY goes on
    143  the same by SIGTERM
    141  nobody reads the output any more

`HYDRA_FULL_ERROR=1` adds the traceback to 2, 3 and 4.
"""

from __future__ import annotations

import logging
import os
import sys
import traceback
from argparse import Namespace
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, ListConfig, OmegaConf

from pinn_cli.cli import inspecting
from pinn_cli.cli.composing import check_what_is_composed
from pinn_cli.cli.help import help_text
from pinn_cli.cli.options import read_options
from pinn_cli.cli.override_errors import explain
from pinn_cli.runs import directories as run_directories
from pinn_cli.runs.claim import Claim, entered
from pinn_cli.runs.interruption import Interruption, watched
from pinn_cli.runs.memory import is_out_of_memory, of_this_machine
from pinn_cli.runs.resume import StoredRun, check_sound, going_on, how_to_go_on
from pinn_cli.runs.writing import OUTPUT, WriteError, refused_by_disk
from pinn_cli.settings.errors import DivergenceError, InputError, NotSoundError
from pinn_cli.sweep import collect, failure
from pinn_cli.sweep.callback import ended_sweep
from pinn_cli.sweep.collect import Collection, collect_command
from pinn_cli.sweep.jobs import NOT_STARTED, Sweep, note_failure

log = logging.getLogger(__name__)

Task = Callable[[DictConfig], float | None]

STATUS_DEFECT, STATUS_INPUT, STATUS_DIVERGED, STATUS_NOT_SOUND, STATUS_INTERRUPTED, STATUS_PIPE = 1, 2, 3, 4, 130, 141
# Errors that a user can mend, or must know of: one line each.
Reported = InputError | DivergenceError | WriteError | NotSoundError
# What launchers raise when a process of theirs is gone: joblib and its pool.
LOST_WORKERS = ("TerminatedWorkerError", "BrokenProcessPool")


class Jobs:
    """The task as Hydra calls it, once per job, and what became of the jobs.

    An error that the user can mend is reported at once and does not reach Hydra, which would print a line of its own.
    A job of a sweep, in this process or in a launcher's worker, leaves any error in its directory and takes no other
    job along; :func:`_collect` reports it.
    """

    def __init__(self, task: Task, full_error: bool) -> None:
        self.task, self.full_error = task, full_error
        self.started = False
        self.status = 0
        self.refused = False
        self.stored: StoredRun | None = None
        self.directory: Path | None = None
        self.begun = False

    def __call__(self, config: DictConfig) -> float | None:
        """Run one job; see the class. What it returns reaches Hydra's sweeper: a score, or None where there is none."""
        self.started = True
        self.directory = Path(HydraConfig.get().runtime.output_dir)
        in_sweep = HydraConfig.get().mode == RunMode.MULTIRUN
        setting = "hydra.sweep.dir" if in_sweep else "hydra.run.dir"
        claim = Claim(self.directory, setting, {} if self.stored else _settings(config))
        with entered(claim):
            try:
                if not in_sweep and not HydraConfig.get().run.dir:
                    raise InputError(setting, HydraConfig.get().run.dir, "a directory")
                return self._run(config, claim, in_sweep)
            except Exception as raised:
                error = _explained(raised)
                _conclude(claim, error)
                if in_sweep and claim.locked:  # else it is no directory of ours to write into
                    overrides = HydraConfig.get().overrides.task
                    note_failure(self.directory, overrides, failure.Failure.of(error))
                elif isinstance(error, Reported) and not in_sweep:
                    self.report(error, how_to_go_on(self.directory) if isinstance(error, WriteError) else "")
                    self.refused = isinstance(error, InputError)
                elif error is raised:
                    raise
                else:
                    raise error from raised
                return None
            finally:
                self.begun = claim.taken

    def _run(self, config: DictConfig, claim: Claim, in_sweep: bool) -> float | None:
        if in_sweep:
            claim.lock()  # from here on it is seen to have begun, should it be killed
            score = self.task(going_on(config))
        else:
            score = self.task(config if self.stored is None else self.stored.configuration(config))
        claim.take()
        if in_sweep:
            failure.clear(claim.directory)
        return score

    def report(self, error: Reported, hint: str = "") -> None:
        """Print the error's one line and note the exit status that it asks for."""
        if self.full_error:
            traceback.print_exception(error)
        else:
            self.print_line(f"{error}; {hint}" if hint else str(error))
        self.status = max(self.status, failure.status_of(error))

    def print_line(self, text: str) -> None:
        """Print one line on standard error."""
        print(f"pinn-run: {' '.join(text.split())}", file=sys.stderr)


def execute(task: Task, look: Task | None = None) -> int:
    """Run a task under the command line that the process was started with.

    Args:
        task: Called with the composed configuration, without its `hydra` node; once per job of a sweep.
        look: The same, where the command line says `inspect`; None: it must not.

    Returns:
        The exit status, as listed at the top of this file.
    """
    jobs = Jobs(task, full_error=os.environ.get("HYDRA_FULL_ERROR") == "1")
    options = Namespace(overrides=[], config_dir=None)
    try:
        options = read_options(sys.argv)
        if look is not None and inspecting.taken_out(sys.argv, options):
            jobs.task = look
        with watched(in_time=True):
            if options.help:
                print(help_text(options.config_dir))
            elif not _has_collected(options) and not _has_finished(jobs, options):
                _run_hydra(jobs)
                _collect(jobs)
            sys.stdout.flush()
    except KeyboardInterrupt as stop:
        ended = ended_sweep()
        if ended is not None:
            goes_on = f"to go on: the same command again; for what there is: {collect_command(ended[0].directory)}"
        else:
            goes_on = how_to_go_on(jobs.directory) if jobs.directory and jobs.begun else ""
            jobs.refused = not jobs.begun
        jobs.print_line(f"interrupted{f'; {goes_on}' if goes_on else ''}")
        return stop.status if isinstance(stop, Interruption) else STATUS_INTERRUPTED
    except BrokenPipeError:  # the reader has left, as in `pinn-run --help | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return STATUS_PIPE
    except Exception as error:
        with suppress(WriteError):  # of which more has been said
            _collect(jobs, cut_off=True)
        if type(error).__name__ in LOST_WORKERS:
            jobs.print_line(
                "a worker process was killed, by the system for want of memory perhaps; the same command again goes on"
            )
            return STATUS_DEFECT
        explained = _told(error, jobs, options)
        if explained is None:
            raise
        jobs.report(explained.with_traceback(error.__traceback__))
        jobs.refused = isinstance(explained, InputError)
    finally:
        if jobs.refused:
            run_directories.discard()
    return jobs.status


def _told(error: Exception, jobs: Jobs, options: Namespace) -> Reported | None:
    """What to tell of an error that no job reported; None of a defect."""
    told = error if isinstance(error, WriteError) else refused_by_disk(error)
    if told is None and isinstance(error, FileNotFoundError) and not jobs.started:  # as below /proc
        told = WriteError(error.filename, error.strerror or "")
    if told is None:
        return explain(error, options.overrides, options.config_dir, composing=not jobs.started)
    if jobs.started or told.path == OUTPUT:
        return told
    setting = "hydra.sweep.dir" if options.multirun else "hydra.run.dir"
    return InputError(setting, told.path, "a directory that can be made", told.reason)


def _has_finished(jobs: Jobs, options: Namespace) -> bool:
    """Have a run that is named by `resume=DIRECTORY` go on, unless it has all its results: that is said in one line."""
    jobs.stored = StoredRun.asked_for(options)
    if jobs.stored is None:
        return False
    if jobs.stored.finished():
        print(f"finished before, nothing to do\n{jobs.stored.directory}")
        if jobs.stored.strict:
            try:
                check_sound(jobs.stored.directory)
            except NotSoundError as error:
                jobs.report(error)
        return True
    sys.argv[1:] = jobs.stored.arguments
    jobs.stored.enter()
    return False


def _has_collected(options: Namespace) -> bool:
    """Have the sweep that is named by `collect=DIRECTORY` put together."""
    directory = collect.asked_for(options)
    if directory is None:
        return False
    sweep = Sweep.read(directory)
    print(Collection.of(sweep, sweep.jobs()).text())
    if sweep.is_search:
        from pinn_cli.search.report import report_search

        print(report_search(directory))
    print(directory)
    return True


def _collect(jobs: Jobs, cut_off: bool = False) -> None:
    """Put the sweep that has ended, or was cut off by an error, together; one that only failed by its input goes."""
    ended = ended_sweep()
    if ended is None:
        return
    sweep, before = ended
    found = sweep.jobs()
    begun = before.begun(found)
    if jobs.full_error:
        for kept in filter(None, (failure.Failure.read(job.directory) for job in begun)):
            print(kept.traceback, file=sys.stderr)
    jobs.refused = before.is_refused(sweep, found) or (cut_off and not begun)
    if jobs.refused:
        for reason in dict.fromkeys(job.reason for job in begun):
            jobs.print_line(reason)
        jobs.status = STATUS_INPUT if begun else jobs.status
        before.restore()
        return
    if all(job.status == NOT_STARTED for job in found):
        return
    collection = Collection.of(sweep, found)
    if not sweep.is_search:  # in which trials may fail
        jobs.status = max(jobs.status, collection.exit_status)
    print(collection.text())
    print(sweep.directory)


def _settings(config: DictConfig) -> dict[str, DictConfig | ListConfig]:
    """What `.hydra/` holds, by file: as Hydra itself would have written it, but for when."""
    hydra = HydraConfig.get()
    return {
        "hydra.yaml": OmegaConf.create({"hydra": hydra}),
        "config.yaml": config,
        "overrides.yaml": OmegaConf.create(hydra.overrides.task),
    }


def _conclude(claim: Claim, error: Exception) -> None:
    """A refused run leaves nothing; one that failed in another way leaves its settings and a log that says so."""
    if isinstance(error, InputError):
        claim.refuse()
        return
    log.info("%s", error if isinstance(error, Reported) else "".join(traceback.format_exception(error)))
    with suppress(InputError):
        claim.take()


def _explained(error: Exception) -> Exception:
    """The same error, or where memory or the disk ran out one that says so in a user's words."""
    if not is_out_of_memory(error):
        full = refused_by_disk(error)
        return error if full is None else full.with_traceback(error.__traceback__)
    given = " ".join(HydraConfig.get().overrides.task) or "(none)"
    allowed = f"such that the run fits into memory; this machine has {of_this_machine() / 2**30:.3g} GiB"
    return InputError("overrides", given, allowed, str(error).partition("\n")[0]).with_traceback(error.__traceback__)


def _run_hydra(jobs: Jobs) -> None:
    check_what_is_composed()
    given = os.environ.get("HYDRA_FULL_ERROR")
    os.environ["HYDRA_FULL_ERROR"] = "1"  # so that Hydra raises, rather than prints and exits with status 1
    try:
        hydra.main(version_base="1.3", config_path="pkg://pinn_cli.conf", config_name="config")(jobs)()
    finally:
        del os.environ["HYDRA_FULL_ERROR"]
        os.environ.update({} if given is None else {"HYDRA_FULL_ERROR": given})
