"""Whose this process is, the command's own or somebody else's, who gets it back as it was; and what it may use.

A run sets much that belongs to the process: threads, Hydra's state, logs, generators of random numbers, the arguments.
The command ends with its run. A process that is borrowed goes on, so that each of these is put back.
"""

from __future__ import annotations

import atexit
import gc
import logging
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, chdir, contextmanager
from functools import cache

from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.version import VersionBase

PACKAGE = "pinn_cli"
# Read by the linear algebra libraries when they are loaded.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# New objects after which Python looks for garbage: as it comes, and while libraries are imported.
_USUAL, _NEW_OBJECTS = gc.get_threshold()[0], 50_000

# What is to be put back; None: the process is the command's own, or a worker's.
_borrowed: ExitStack | None = None


def is_borrowed() -> bool:
    """Whether the process is somebody else's."""
    return _borrowed is not None


@contextmanager
def borrowed(arguments: Sequence[str]) -> Iterator[None]:
    """Have the process be the command's own within the block, with these `sys.argv`, and as it was after it."""
    global _borrowed  # noqa: PLW0603
    from pinn_cli.runs.checkpoint import random_states, set_random_states  # not for --help, which reads this file

    with ExitStack() as stack:
        stack.callback(setattr, sys, "argv", sys.argv)
        stack.enter_context(chdir("."))  # a run that goes on enters the folder that it was started in
        stack.callback(set_random_states, random_states())
        stack.enter_context(_hydra())
        stack.enter_context(_logs())
        sys.argv, _borrowed = list(arguments), stack
        try:
            yield
        finally:
            _borrowed = None


def prepare_process(threads: int) -> None:
    """Limit the threads of torch and of the linear algebra, whose last digits depend on them: a run begins."""
    variables = dict.fromkeys(THREAD_VARIABLES, str(threads))
    if _borrowed is not None:
        # What is loaded later would keep for good the number that the environment then has.
        import scipy.linalg  # noqa: F401
        from threadpoolctl import threadpool_limits

        _borrowed.enter_context(environment(variables))
        _borrowed.enter_context(threadpool_limits(threads, "blas"))
    else:
        # It looks for no garbage when it ends, for half a second: the system takes all memory back anyway.
        atexit.unregister(gc.freeze)
        atexit.register(gc.freeze)
    os.environ.update(variables)
    import torch

    if _borrowed is not None:
        _borrowed.callback(torch.set_num_threads, torch.get_num_threads())
    torch.set_num_threads(threads)


@contextmanager
def environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Have the process's environment say so within the block."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            os.environ.update({} if value is None else {name: value})


@cache  # once in a process, however many jobs it runs: the first imports what there is to import
def collect_rarely() -> None:
    """Have Python look for garbage less often, until :func:`keep_imported`: while libraries are imported.

    They make half a million objects that stay, and it would look at them again and again: half a second.
    """
    gc.set_threshold(_NEW_OBJECTS)


@cache  # once: what a sweep's jobs leave behind is to be found
def keep_imported() -> None:
    """Have Python look for garbage as usual again, but not among the objects that there are."""
    gc.set_threshold(_USUAL)
    gc.freeze()


@contextmanager
def _hydra() -> Iterator[None]:
    """Hydra has one state for the process, which its owner may be using."""
    base = VersionBase.instance()
    instance, config, before = GlobalHydra.instance(), HydraConfig.instance().cfg, base.version_base
    owners, instance.hydra = instance.hydra, None
    try:
        yield
    finally:
        GlobalHydra.set_instance(instance)
        instance.hydra = owners
        HydraConfig.instance().cfg = config
        base.version_base = before


@contextmanager
def _logs() -> Iterator[None]:
    """The run's own log hears more than its owner, who hears what he did before; with no logs at all, warnings."""
    root, package = logging.getLogger(), logging.getLogger(PACKAGE)
    level, heard = package.level, package.getEffectiveLevel()

    def was_heard(record: logging.LogRecord) -> bool:
        return record.levelno >= heard or not f"{record.name}.".startswith(f"{PACKAGE}.")

    handlers, console = list(root.handlers), logging.StreamHandler(sys.stderr)
    console.setLevel(logging.WARNING)
    console.setFormatter(logging.Formatter("pinn-run: %(message)s"))
    if not handlers:
        root.addHandler(console)
    hushed = handlers or [console]
    for handler in hushed:
        handler.addFilter(was_heard)
    package.setLevel(min(heard, logging.INFO))
    try:
        yield
    finally:
        package.setLevel(level)
        for handler in hushed:
            handler.removeFilter(was_heard)
        root.removeHandler(console)


# Where the system does not tell, bytes.
_UNTOLD = 2**40


def usable_cores() -> list[int]:
    """Those that this process may run on."""
    affinity = getattr(os, "sched_getaffinity", None)
    return sorted(affinity(0)) if affinity else list(range(os.cpu_count() or 1))


def of_this_machine() -> int:
    """All its memory, bytes."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return _UNTOLD


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an exception says that there is no memory left: torch has none of its own for that on the CPU."""
    return isinstance(error, MemoryError) or "can't allocate memory" in str(error) or "out of memory" in str(error)
