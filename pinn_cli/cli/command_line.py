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

import os
import sys
import traceback
from argparse import Namespace
from contextlib import AbstractContextManager, suppress

from pinn_cli.cli.help import help_text
from pinn_cli.cli.jobs import Jobs, Reported, Task
from pinn_cli.cli.options import FOLLOW, INSPECT, read_options
from pinn_cli.cli.override_errors import explain
from pinn_cli.cli.terminal import Terminal
from pinn_cli.runs.claim import discard
from pinn_cli.runs.interruption import Interruption, watched
from pinn_cli.runs.reading import printable
from pinn_cli.runs.resume import StoredRun, check_sound, how_to_go_on
from pinn_cli.runs.writing import OUTPUT, WriteError, refused_by_disk
from pinn_cli.settings.errors import InputError
from pinn_cli.sweep import collect, failure
from pinn_cli.sweep.callback import ended_sweep, leave_sweep
from pinn_cli.sweep.collect import Collection, collect_command
from pinn_cli.sweep.jobs import NOT_STARTED, Sweep

STATUS_DEFECT, STATUS_INPUT, STATUS_INTERRUPTED, STATUS_PIPE = 1, 2, 130, 141
# What launchers raise when a process of theirs is gone: joblib and its pool.
LOST_WORKERS = ("TerminatedWorkerError", "BrokenProcessPool")


def execute(task: Task, look: Task | None = None, follow: Task | None = None) -> int:
    """Run a task under the command line that the process was started with.

    Args:
        task: Called with the composed configuration, without its `hydra` node; once per job of a sweep.
        look: The same, where the command line says `inspect`; None: it must not.
        follow: The same, where it says `follow`.

    Returns:
        The exit status, as listed at the top of this file.
    """
    jobs = Jobs(task, Terminal(), full_error=os.environ.get("HYDRA_FULL_ERROR") == "1")
    try:
        perform(jobs, look, watched(in_time=True), follow)
    except KeyboardInterrupt as stop:
        jobs.terminal.complain(f"interrupted{f'; {jobs.hint}' if jobs.hint else ''}")
        return stop.status if isinstance(stop, Interruption) else STATUS_INTERRUPTED
    except failure.UnansweredError as error:
        jobs.terminal.complain(f"{error}; {jobs.hint}")
        return STATUS_DEFECT
    except BrokenPipeError:  # the reader has left, as in `pinn-run --help | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return STATUS_PIPE
    except Exception as error:
        if type(error).__name__ in LOST_WORKERS:
            jobs.terminal.complain(
                "a worker process was killed, by the system for want of memory perhaps; the same command again goes on"
            )
            return STATUS_DEFECT
        if not isinstance(error, Reported):
            raise
        if jobs.full_error:
            traceback.print_exception(error)
        else:
            jobs.terminal.complain(f"{error}; {jobs.hint}" if jobs.hint else str(error))
        return max(jobs.status, failure.status_of(error))
    return jobs.status


def perform(jobs: Jobs, look: Task | None, watch: AbstractContextManager[None], follow: Task | None = None) -> None:
    """Do what `sys.argv` says, whoever put it there: a shell or a caller in Python; it stays as it is.

    Args:
        jobs: Of this start; says afterwards what became of them.
        look: See :func:`execute`.
        watch: What is done about signals meanwhile.
        follow: See :func:`execute`.

    Raises:
        InputError: Nothing can use the input; nothing is left of it.
        DivergenceError: See :class:`pinn_cli.settings.errors.DivergenceError`; like the next two of a single run only.
        WriteError: The disk takes no more.
        NotSoundError: The verdict is not sound, and strict=true.
        KeyboardInterrupt: It was interrupted; `jobs.hint` says how to go on.
    """
    options = Namespace(overrides=[], config_dir=None)
    try:
        options = read_options(sys.argv[1:])
        if look is not None and INSPECT.taken_out(options):
            jobs.task = look
        if follow is not None and FOLLOW.taken_out(options):
            jobs.task, jobs.goes_on_by = follow, "the same command"
        with watch:
            if options.help:
                jobs.terminal.say(help_text(options.config_dir))
            elif not _has_collected(jobs, options) and not _has_finished(jobs, options):
                _start(jobs, options)
                _collect(jobs)
            sys.stdout.flush()
    except (KeyboardInterrupt, failure.UnansweredError):
        _note_how_to_go_on(jobs)
        raise
    except BrokenPipeError:
        raise
    except Exception as error:
        with suppress(WriteError):  # of which more has been said
            _collect(jobs, cut_off=True)
        told = None if type(error).__name__ in LOST_WORKERS else _told(error, jobs, options)
        if told is not None:
            jobs.refused = isinstance(told, InputError)
        if told is None or told is error:
            raise
        raise told.with_traceback(error.__traceback__) from None
    finally:
        leave_sweep()
        if jobs.refused:
            discard()
    if jobs.error is not None:
        raise jobs.error


def _note_how_to_go_on(jobs: Jobs) -> None:
    """What is to be said where a run or the wait for a sweep was broken off."""
    ended = ended_sweep()
    if ended is not None:
        jobs.hint = f"to go on: the same command again; for what there is: {collect_command(ended[0].directory)}"
        return
    jobs.hint = how_to_go_on(jobs.directory, jobs.goes_on_by) if jobs.directory and jobs.begun else ""
    jobs.refused = not jobs.begun


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
        jobs.directory = jobs.stored.directory
        jobs.terminal.say(f"finished before, nothing to do\n{jobs.stored.directory}")
        if jobs.stored.strict:
            check_sound(jobs.stored.directory)
        return True
    jobs.stored.enter()
    return False


def _has_collected(jobs: Jobs, options: Namespace) -> bool:
    """Have the sweep that is named by `collect=DIRECTORY` put together."""
    directory = collect.asked_for(options)
    if directory is None:
        return False
    sweep = Sweep.read(directory)
    jobs.terminal.say(Collection.of(sweep, sweep.jobs()).text())
    if sweep.is_search:
        from pinn_cli.search.report import report_search

        jobs.terminal.say(report_search(directory))
    jobs.terminal.say(str(directory))
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
            print(printable(kept.traceback), file=sys.stderr)
    jobs.refused = before.is_refused(sweep, found) or (cut_off and not begun)
    if jobs.refused:
        jobs.reasons = list(dict.fromkeys(job.reason for job in begun))
        for reason in () if cut_off else jobs.reasons:  # of what has cut it off there is a line of its own
            jobs.terminal.complain(reason)
        jobs.status = STATUS_INPUT if begun else jobs.status
        before.restore()
        return
    if all(job.status == NOT_STARTED for job in found):
        return
    collection = Collection.of(sweep, found)
    if not sweep.is_search:  # in which trials may fail
        jobs.status = max(jobs.status, collection.exit_status)
    jobs.directory = sweep.directory
    jobs.terminal.say(collection.text())
    jobs.terminal.say(str(sweep.directory))


def _start(jobs: Jobs, options: Namespace) -> None:
    from pinn_cli.cli.starting import show, start  # not for --help

    if jobs.stored is not None:
        overrides, config_dir = jobs.stored.arguments, None
    else:
        overrides, config_dir = options.overrides, options.config_dir
    if options.cfg or options.info or options.hydra_help or options.shell_completion:
        show(options, overrides, config_dir)
    else:
        start(jobs, [*overrides, *jobs.of_hydra], config_dir, options.multirun)
