"""Whose this process is: the command's own, or somebody else's, as a notebook's, who gets it back as it was.

A run sets much that belongs to the process: threads, Hydra's state, logs, generators of random numbers, the arguments.
The command ends with its run. A process that is borrowed goes on, so that each of these is put back.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager

from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.version import VersionBase

from pinn_cli.runs.memory import leave_without_collecting

PACKAGE = "pinn_cli"
# Read by the linear algebra libraries when they are loaded.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

# What is to be put back; None: the process is the command's own, or a worker's.
_borrowed: ExitStack | None = None


def is_borrowed() -> bool:
    """Whether the process is somebody else's."""
    return _borrowed is not None


@contextmanager
def borrowed(arguments: Sequence[str]) -> Iterator[None]:
    """Have the process be as if it were the command's own within the block.

    Args:
        arguments: As `sys.argv` is to have them meanwhile.
    """
    global _borrowed  # noqa: PLW0603
    with ExitStack() as stack:
        for lent in (_arguments(arguments), _folder(), _random_states(), _hydra(), _logs()):
            stack.enter_context(lent)
        _borrowed = stack
        try:
            yield
        finally:
            _borrowed = None


def prepare_process(threads: int) -> None:
    """Limit the threads of torch and of the linear algebra: a run begins."""
    if _borrowed is None:
        leave_without_collecting()
    else:
        _borrowed.enter_context(_threads(threads))
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, str(threads)))
    import torch

    torch.set_num_threads(threads)


@contextmanager
def _threads(threads: int) -> Iterator[None]:
    """As many threads of the linear algebra as a run has, whose last digits depend on it."""
    # What is loaded later would keep for good the number that the environment then has.
    import scipy.linalg  # noqa: F401
    import torch
    from threadpoolctl import threadpool_limits

    before = torch.get_num_threads()
    try:
        with environment(dict.fromkeys(THREAD_VARIABLES, str(threads))), threadpool_limits(threads, "blas"):
            yield
    finally:
        torch.set_num_threads(before)


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


@contextmanager
def _arguments(arguments: Sequence[str]) -> Iterator[None]:
    before, sys.argv = sys.argv, list(arguments)
    try:
        yield
    finally:
        sys.argv = before


@contextmanager
def _folder() -> Iterator[None]:
    before = os.getcwd()
    try:
        yield
    finally:
        if os.getcwd() != before:  # a run that goes on enters the folder that it was started in
            os.chdir(before)


@contextmanager
def _random_states() -> Iterator[None]:
    from pinn_cli.runs.checkpoint import random_states, set_random_states  # not for --help, which reads this file

    before = random_states()
    try:
        yield
    finally:
        set_random_states(before)


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
