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

import json
import logging
import os
import shlex
import sys
import traceback
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from functools import partial
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, ListConfig, OmegaConf

from pinn_cli.cli.help import explain, help_text
from pinn_cli.cli.options import read_options
from pinn_cli.cli.terminal import AS_JSON, QUIET, Terminal
from pinn_cli.runs.claim import Claim, discard, entered
from pinn_cli.runs.interruption import Interruption, stop_if_asked, watched
from pinn_cli.runs.process import is_out_of_memory, of_this_machine
from pinn_cli.runs.reading import printable, stamp
from pinn_cli.runs.resume import FORMAT, StoredRun, check_sound, going_on, how_to_go_on
from pinn_cli.runs.writing import OUTPUT, WriteError, refused_by_disk
from pinn_cli.settings.errors import DivergenceError, InputError, NotSoundError
from pinn_cli.sweep.collect import asked_for, collected
from pinn_cli.sweep.jobs import DEFECT, FAILURE, INPUT, NOT_STARTED, Failure, Sweep, status_of
from pinn_cli.sweep.running import ended_sweep, leave_sweep

log = logging.getLogger(__name__)

STATUS_INTERRUPTED, STATUS_PIPE = 130, 141
# What launchers raise when a process of theirs is gone: joblib and its pool.
LOST_WORKERS = ("TerminatedWorkerError", "BrokenProcessPool")

# Called with a composed configuration, and with the terminal that it prints to where that is not the usual one.
Task = Callable[..., float | None]

# Overrides that leave the terminal to us: the run's log is written all the same; or the process's logging is its own.
SILENT = ("hydra/job_logging=silent", "hydra/hydra_logging=none")
WITHOUT_LOGS = ("hydra/job_logging=none", "hydra/hydra_logging=none")

# Errors that a user can mend, or must know of: one line each.
REPORTED = (InputError, DivergenceError, WriteError, NotSoundError)


class Jobs:
    """The task as Hydra calls it, once per job, and what became of the jobs.

    An error of a single run is kept in `error` and does not reach Hydra, which would print a line of its own. A job of
    a sweep, in this process or in a launcher's worker, leaves any error in its directory and takes no other job along;
    what collects the sweep reports it.

    Args:
        task: See :func:`execute`.
        terminal: Who is told.
        of_hydra: Overrides of Hydra's own settings, put after those of the user.

    Attributes:
        error: Of the run, and in `hint` what to do about it; None where there is none.
        reasons: Why every job of a sweep was refused.
        refused: Whether nothing is to be left of it.
        stored: The run that is gone on with; None: it is another one.
        directory: Of the last run, or of the sweep that has ended.
        goes_on_by: What goes on with an interrupted run; "": `pinn-run resume=...`.
    """

    def __init__(self, task: Task, terminal: Terminal, of_hydra: Sequence[str] = ()) -> None:
        self.task, self.terminal, self.of_hydra = task, terminal, of_hydra
        self.started = self.begun = self.refused = False
        self.status = 0
        self.error: Exception | None = None
        self.hint = self.goes_on_by = ""
        self.reasons: list[str] = []
        self.stored: StoredRun | None = None
        self.directory: Path | None = None

    def __call__(self, config: DictConfig) -> float | None:
        """Run one job; what it returns reaches Hydra's sweeper: a score, or None where there is none."""
        hydra = HydraConfig.get()
        self.started, self.directory = True, Path(hydra.runtime.output_dir)
        in_sweep = hydra.mode == RunMode.MULTIRUN
        # What `.hydra/` holds, by file: as Hydra itself would have written it, but for when.
        settings: dict[str, DictConfig | ListConfig] = {
            "hydra.yaml": OmegaConf.create({**stamp(FORMAT), "hydra": hydra}),
            "config.yaml": config,
            "overrides.yaml": OmegaConf.create(hydra.overrides.task),
        }
        setting = "hydra.sweep.dir" if in_sweep else "hydra.run.dir"
        claim = Claim(self.directory, setting, {} if self.stored else settings)
        with entered(claim):
            try:
                if in_sweep:
                    claim.lock()  # from here on it is seen to have begun, should it be killed
                    config = going_on(config)
                elif not hydra.run.dir:
                    raise InputError(setting, hydra.run.dir, "a directory")
                elif self.stored:
                    config = self.stored.configuration(config)
                score = self.task(config)
                claim.take()
                if in_sweep:
                    (claim.directory / FAILURE).unlink(missing_ok=True)
                return score
            except Exception as raised:
                stop_if_asked()
                self.error = error = _explained(raised)
                _conclude(claim, error)
                if in_sweep:
                    if not claim.locked:  # it is no directory of ours to write into
                        raise error from raised
                    Failure.of(error).write(self.directory, hydra.overrides.task)
                    self.error = None
                elif isinstance(error, WriteError):
                    self.hint = how_to_go_on(self.directory, self.goes_on_by)
                return None
            finally:
                self.begun = claim.taken

    def tell(self, text: str, directory: Path) -> None:
        """Print what there is in a directory, and at last the directory."""
        self.directory = directory
        self.terminal.say(text)
        self.terminal.conclude(directory)


def _conclude(claim: Claim, error: Exception) -> None:
    """A refused run leaves nothing; one that failed in another way leaves its settings and a log that says so."""
    if isinstance(error, InputError):
        claim.refuse()
        return
    log.info("%s", error if isinstance(error, REPORTED) else "".join(traceback.format_exception(error)))
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


def execute(task: Task, subcommands: Mapping[str, Task] | None = None) -> int:
    """Run a task under the command line that the process was started with.

    Args:
        task: Called with the composed configuration, without its `hydra` node; once per job of a sweep.
        subcommands: The same, where the command line has this word, such as `inspect`.

    Returns:
        The exit status, as listed at the top of this file.
    """
    jobs = Jobs(task, Terminal())
    try:
        perform(jobs, watched(in_time=True), subcommands)
    except KeyboardInterrupt as stop:
        jobs.terminal.complain(f"interrupted{f'; {jobs.hint}' if jobs.hint else ''}")
        return stop.status if isinstance(stop, Interruption) else STATUS_INTERRUPTED
    except BrokenPipeError:  # the reader has left, as in `pinn-run --help | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return STATUS_PIPE
    except REPORTED as error:
        if _is_verbose():
            traceback.print_exception(error)
        else:
            jobs.terminal.complain(f"{error}; {jobs.hint}" if jobs.hint else str(error))
        return max(jobs.status, status_of(error))
    except Exception as error:
        if type(error).__name__ not in LOST_WORKERS:
            raise
        jobs.terminal.complain(
            "a worker process was killed, by the system for want of memory perhaps; the same command again goes on"
        )
        return DEFECT
    return jobs.status


def perform(jobs: Jobs, watch: AbstractContextManager[None], subcommands: Mapping[str, Task] | None = None) -> None:
    """Do what `sys.argv` says, whoever put it there: a shell or a caller in Python; it stays as it is.

    Args:
        jobs: Of this start; says afterwards what became of them.
        watch: What is done about signals meanwhile.
        subcommands: Tasks in place of that of `jobs`, by the word that asks for them.

    Raises:
        InputError: Nothing can use the input; nothing is left of it.
        DivergenceError: A training left the numbers that a computer can hold; like the next two of a single run only.
        WriteError: The disk takes no more.
        NotSoundError: The verdict is not sound, and strict=true.
        KeyboardInterrupt: It was interrupted; `jobs.hint` says how to go on.
    """
    options = Namespace(overrides=[], config_dir=None)
    try:
        options = read_options(sys.argv[1:])
        jobs.task = (subcommands or {}).get(options.subcommand, jobs.task)
        if options.quiet or options.json:
            jobs.terminal, jobs.of_hydra = AS_JSON if options.json else QUIET, SILENT
            jobs.task = partial(jobs.task, terminal=jobs.terminal)
            jobs.goes_on_by = "the same command" if options.subcommand == "follow" else ""
        with watch:
            _begin(jobs, options)
            sys.stdout.flush()
        if jobs.error is not None:
            raise jobs.error
    except KeyboardInterrupt:
        _note_how_to_go_on(jobs)
        raise
    except BrokenPipeError:
        raise
    except Exception as error:
        with suppress(WriteError):  # of which more has been said
            _collect(jobs, cut_off=True)
        reported = _as_reported(error, jobs, options)
        if reported is not None:
            jobs.refused = isinstance(reported, InputError)
        if reported is None or reported is error:
            raise
        raise reported.with_traceback(error.__traceback__) from None
    finally:
        leave_sweep()
        if jobs.refused:
            discard()


def _begin(jobs: Jobs, options: Namespace) -> None:
    """Print what is asked for, put a sweep together, or start."""
    terminal, overrides, config_dir = Terminal(), options.overrides, options.config_dir
    if options.help:
        terminal.say(help_text(config_dir, overrides))
        return
    if options.json_schema:
        from pinn_cli.cli.schema import json_schema  # which reads much of the program

        terminal.say(json.dumps(json_schema(config_dir), indent=1))
        return
    directory = asked_for(options)
    if directory is not None:
        sweep = Sweep.read(directory)
        jobs.tell(collected(sweep, sweep.jobs())[1], directory)
        return
    jobs.stored = StoredRun.asked_for(options)
    if jobs.stored is not None:
        if jobs.stored.finished():
            jobs.tell("finished before, nothing to do", jobs.stored.directory)
            if jobs.stored.strict:
                check_sound(jobs.stored.directory)
            return
        jobs.stored.enter()
        overrides, config_dir = jobs.stored.arguments, None
    from pinn_cli.cli.composing import configuration_text, show_by_hydra, start  # not for --help

    if options.hydra_help:
        show_by_hydra("--hydra-help")
    elif options.shell_completion:
        show_by_hydra("--shell-completion", overrides)
    elif options.cfg:
        terminal.say(configuration_text(options, overrides, config_dir))
    else:
        start(jobs, [*overrides, *jobs.of_hydra], config_dir, options.multirun)
        _collect(jobs)


def _note_how_to_go_on(jobs: Jobs) -> None:
    """What is to be said where a run or the wait for a sweep was broken off."""
    ended = ended_sweep()
    if ended is not None:
        command = shlex.join(["pinn-run", f"collect={ended.sweep.directory}"])
        jobs.hint = f"to go on: the same command again; for what there is: {command}"
        return
    jobs.hint = how_to_go_on(jobs.directory, jobs.goes_on_by) if jobs.directory and jobs.begun else ""
    jobs.refused = not jobs.begun


def _as_reported(error: Exception, jobs: Jobs, options: Namespace) -> Exception | None:
    """What to tell of an error; None of a defect."""
    if error is jobs.error or type(error).__name__ in LOST_WORKERS:
        return error if isinstance(error, REPORTED) else None
    reported = error if isinstance(error, WriteError) else refused_by_disk(error)
    if reported is None and isinstance(error, FileNotFoundError) and not jobs.started:  # as below /proc
        reported = WriteError(error.filename, error.strerror or "")
    if reported is None:
        return explain(error, options.overrides, options.config_dir, composing=not jobs.started)
    if jobs.started or reported.path == OUTPUT:
        return reported
    setting = "hydra.sweep.dir" if options.multirun else "hydra.run.dir"
    return InputError(setting, reported.path, "a directory that can be made", reported.reason)


def _collect(jobs: Jobs, cut_off: bool = False) -> None:
    """Put the sweep that has ended, or was cut off by an error, together; one that only failed by its input goes."""
    ended = ended_sweep()
    if ended is None:
        return
    sweep = ended.sweep
    all_jobs = sweep.jobs()
    begun = ended.begun(all_jobs)
    if _is_verbose():
        for kept in filter(None, (Failure.read(job.directory) for job in begun)):
            print(printable(kept.traceback), file=sys.stderr)
    jobs.refused = ended.is_refused(all_jobs, begun) or (cut_off and not begun)
    if jobs.refused:
        jobs.reasons = list(dict.fromkeys(job.reason for job in begun))
        for reason in () if cut_off else jobs.reasons:  # of what has cut it off there is a line of its own
            jobs.terminal.complain(reason)
        jobs.status = INPUT if begun else jobs.status
        ended.restore()
        return
    if all(job.status == NOT_STARTED for job in all_jobs):
        return
    ended_jobs, text = collected(sweep, all_jobs)
    if not sweep.is_search:  # in which trials may fail
        jobs.status = max(jobs.status, *(job.exit_status for job in ended_jobs))
    jobs.tell(text, sweep.directory)


def _is_verbose() -> bool:
    """Whether tracebacks are printed, too."""
    return os.environ.get("HYDRA_FULL_ERROR") == "1"
