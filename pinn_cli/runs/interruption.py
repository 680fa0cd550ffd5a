"""Signals that stop a run, SIGINT (Ctrl-C) and SIGTERM, or warn it; how a training puts them off to a step's end.

A step that takes longer than `PATIENCE_S` is broken off, and a call of a library that takes longer than `GRACE_S` ends
with the process: Python hears of a signal only between two calls. What is on the disk is whole whenever that happens.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
# Seconds that a signal is put off at most, and from a signal to the process's end at the latest.
PATIENCE_S, GRACE_S = 2.5, 4.5

# Handlers belong to the process, and so does what they note: how many blocks put signals off, the one that came, and
# whether one came that only warns.
_deferring = 0
_asked: int | None = None
_warnings: list[int] = []
_ends_at_second = True


class Interruption(KeyboardInterrupt):
    """The program was asked to stop. No `except Exception` holds it up; files that are being written go with it.

    Attributes:
        status: The exit status that shells give to that signal, 130 or 143.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.status = 128 + number


@contextmanager
def watched(signals: Sequence[int] = SIGNALS, in_time: bool = False, ends: bool = True) -> Iterator[None]:
    """Have these signals raise `Interruption` in the block; a second Ctrl-C ends the process at once, if it ``ends``.

    With ``in_time`` nothing holds them up for longer than `GRACE_S` seconds.

    A signal that the process was started to ignore, as under `nohup`, stays ignored. Elsewhere than in the main thread
    Python has no signals and the block runs as it is.
    """
    global _asked, _ends_at_second  # noqa: PLW0603
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heeded = [number for number in signals if signal.getsignal(number) != signal.SIG_IGN]
    before = {number: signal.signal(number, _receive) for number in heeded}
    _ends_at_second = ends
    try:
        with _ended_in_time(heeded) if in_time else nullcontext():
            yield
    except Exception:
        stop_if_asked()
        raise
    finally:
        _asked, _ends_at_second = None, True
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _ended_in_time(signals: Sequence[int]) -> Iterator[None]:
    """Have steps broken off, and at last the process ended, where one of these signals is not answered in time."""
    mine, systems = socket.socketpair()
    systems.setblocking(False)
    over = threading.Event()
    before = signal.set_wakeup_fd(systems.fileno(), warn_on_full_buffer=False)
    alarm = signal.signal(signal.SIGALRM, _break_off)
    threading.Thread(target=_await_signal, args=(mine, signals, over), name="signals", daemon=True).start()
    try:
        yield
    finally:
        over.set()
        signal.set_wakeup_fd(before)
        signal.signal(signal.SIGALRM, alarm)
        systems.close()


def _await_signal(numbers: socket.socket, signals: Sequence[int], over: threading.Event) -> None:
    """In a thread of its own, which runs on while a library computes: the system itself writes the signal's number."""
    with numbers:
        while received := numbers.recv(1):
            if received[0] in signals:
                if over.wait(PATIENCE_S):
                    return
                signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGALRM)
                if over.wait(GRACE_S - PATIENCE_S):
                    return
                with suppress(OSError, ValueError):
                    print("pinn-run: interrupted in a long computation; the same command goes on", file=sys.stderr)
                os._exit(128 + received[0])


def _break_off(number: int, frame: FrameType | None) -> None:
    """A signal has been put off for long enough."""
    if _asked is not None and _deferring:
        raise Interruption(_asked)


@contextmanager
def deferred() -> Iterator[None]:
    """Put signals off to the end of the block, which may look at `asked` meanwhile.

    Raises:
        Interruption: At the end of the block, if a signal came.
    """
    global _deferring  # noqa: PLW0603
    _deferring += 1
    try:
        yield
    finally:
        _deferring -= 1
    stop_if_asked()


@contextmanager
def heeded() -> Iterator[None]:
    """Within `deferred`: have a signal raise at once again, in a part of the block that may be broken off anywhere.

    Raises:
        Interruption: When a signal comes, or because one came before.
    """
    global _deferring  # noqa: PLW0603
    _deferring -= 1
    try:
        stop_if_asked()
        yield
    finally:
        _deferring += 1


def stop_if_asked() -> None:
    """Also where an error came up: a library whose import was broken off by a signal raises anything.

    Raises:
        Interruption: A signal came that was not put off, or is not any more.
    """
    if _asked is not None and not _deferring:
        raise Interruption(_asked)


def asked() -> bool:
    """Whether a signal came that was put off."""
    return _asked is not None


@contextmanager
def warning(number: int) -> Iterator[None]:
    """Have a signal ask for a checkpoint and stop nothing: schedulers send one some time before they kill."""
    before = signal.signal(number, lambda *_: _warnings.append(number))
    try:
        yield
    finally:
        signal.signal(number, before)


def warned() -> bool:
    """Whether such a signal came since this was asked last."""
    came = bool(_warnings)
    _warnings.clear()
    return came


def _receive(number: int, frame: FrameType | None) -> None:
    global _asked
    if number == signal.SIGINT and _ends_at_second:  # the second one is the system's, which waits for no computation
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    repeated, _asked = _asked is not None, number if _asked is None else _asked
    # Schedulers send SIGTERM more than once; what the first one set off is let finish.
    if not _deferring and not repeated:
        raise Interruption(number)
