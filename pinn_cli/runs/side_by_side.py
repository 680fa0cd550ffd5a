"""Work on several items alike, such as records: one after the other, or side by side on the cores.

Threads would wait for each other: much of the work are short steps of Python. So the items are shared out among copies
of this process, which stay as long as what holds them does: what a function changes of an item stays changed there, and
there alone. Every item's numbers are computed in the same way wherever that is, and come in the items' order: they do
not depend on how many cores there are.
"""

from __future__ import annotations

import ctypes
import gc
import os
import pickle
import signal
import sys
import traceback
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import Pipe, current_process
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

from pinn_cli.runs.cores import usable_cores
from pinn_cli.runs.writing import WriteError
from pinn_cli.settings.errors import DivergenceError, InputError

R = TypeVar("R")
T = TypeVar("T")

# Of Linux's prctl; and how much less of a busy core such copies take: two thirds of what this process does.
_PR_SET_PDEATHSIG, _BEHIND = 1, 2


class Items(Generic[T]):
    """Items that are worked on in this process, one after the other.

    Args:
        items: Which.
    """

    def __init__(self, items: Sequence[T]) -> None:
        self.items = list(items)
        self.close: Callable[[], object] = lambda: None  # ends what works on them, whatever it is about

    def each(self, function: Callable[..., R], *arguments: Sequence[Any]) -> list[R]:
        """What a function makes of every item, in their order.

        Args:
            function: Of a file's, of (item, its own of every argument).
            arguments: Each with one entry for every item.
        """
        return self.begin(function, *arguments)()

    def begin(self, function: Callable[..., R], *arguments: Sequence[Any]) -> Callable[[], list[R]]:
        """Begin with what :meth:`each` does; what is returned waits for the answers, and is to be called."""
        return lambda: [function(*given) for given in zip(self.items, *arguments, strict=True)]


# The ends of all pipes to copies that are alive: a copy must not keep those of others open.
_ends: weakref.WeakSet[Connection] = weakref.WeakSet()


class SharedOutItems(Items[T]):
    """The same in copies of this process, which end with this object or with the process.

    Args:
        items: Which.
        copies: How many.
        sizes: Of the work on each; None: all alike.
        behind: Whether they leave the cores to this process where these are few.
    """

    def __init__(
        self, items: Sequence[T], copies: int, sizes: Sequence[int] | None = None, behind: bool = False
    ) -> None:
        super().__init__(items)
        self.niceness = _BEHIND if behind else 0
        self.shares = shared_out([1] * len(items) if sizes is None else sizes, copies)
        self.ends: list[Connection] = []
        pids: list[int] = []
        for _ in self.shares:
            pid, end = self._copy()
            pids.append(pid)
            self.ends.append(end)
        self.close = weakref.finalize(self, _end, os.getpid(), self.ends, pids)

    def begin(self, function: Callable[..., R], *arguments: Sequence[Any]) -> Callable[[], list[R]]:
        """See :meth:`Items.begin`; what the copies do meanwhile goes on at once."""
        tasks = list(zip(*arguments, strict=True)) if arguments else [()] * len(self.items)
        with self._answering():
            for end, share in zip(self.ends, self.shares, strict=True):
                end.send_bytes(pickle.dumps((function, [(i, tasks[i]) for i in share]), pickle.HIGHEST_PROTOCOL))
        return self._answers

    def _answers(self) -> list[Any]:
        found: dict[int, Any] = {}
        with self._answering():
            for end in self.ends:
                found.update(_received(end))
        return [found[i] for i in range(len(self.items))]

    @contextmanager
    def _answering(self) -> Iterator[None]:
        try:
            yield
        except (EOFError, BrokenPipeError, ConnectionResetError):
            self.close()
            raise MemoryError("a process that worked beside this one was killed: out of memory?") from None
        except BaseException:
            self.close()  # whatever is still on its way belongs to no question any more
            raise

    def _copy(self) -> tuple[int, Connection]:
        mine, its = Pipe()
        owner = os.getpid()
        pid = os.fork()
        if pid == 0:
            _serve(self.items, its, [mine, *_ends], owner, self.niceness)
        its.close()
        _ends.add(mine)
        return pid, mine


def side_by_side(items: Sequence[T], sizes: Sequence[int] | None = None, copied: bool = True) -> Items[T]:
    """Items on as many cores as there are.

    Args:
        items: Which.
        sizes: Of the work on each; None: all alike.
        copied: False: in this process all the same, as where a GPU holds them.
    """
    copies = min(len(items), len(usable_cores()))
    return SharedOutItems(items, copies, sizes) if copies > 1 and copied and _can_copy() else Items(items)


def beside(item: T) -> Items[T]:
    """One item in a copy of this process that leaves the cores to it; in this process where there is but one core."""
    return SharedOutItems([item], 1, behind=True) if _can_copy() and len(usable_cores()) > 1 else Items([item])


def _can_copy() -> bool:
    # macOS has fork, but its own libraries do not survive it.
    return sys.platform.startswith("linux") and not current_process().daemon


def shared_out(sizes: Sequence[int], copies: int) -> list[list[int]]:
    """Shares of about the same size in all: the largest first, each to who has least so far."""
    shares: list[list[int]] = [[] for _ in range(copies)]
    for i in sorted(range(len(sizes)), key=lambda i: -sizes[i]):
        min(shares, key=lambda share: sum(sizes[j] for j in share)).append(i)
    return [sorted(share) for share in shares]


def _received(end: Connection) -> dict[int, Any]:
    answer = pickle.loads(end.recv_bytes())
    if isinstance(answer, BaseException):
        raise answer
    return dict(answer)


def _serve(
    items: Sequence[Any], questions: Connection, others: Sequence[Connection], owner: int, niceness: int
) -> None:
    """What a copy does until nobody asks any more; it never returns to what this process was about."""
    status = 1
    try:
        _end_with(owner)
        os.nice(niceness)
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one that asks
        for number in (signal.SIGTERM, signal.SIGALRM):
            signal.signal(number, signal.SIG_DFL)
        for other in others:
            other.close()
        gc.freeze()
        if "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(1)  # other threads are not copied
        with suppress(EOFError, BrokenPipeError):
            for function, tasks in _asked(questions):
                questions.send_bytes(_answer(items, function, tasks))
        status = 0
    finally:
        os._exit(status)


def _end_with(owner: int) -> None:
    """Have Linux kill this process when its owner is gone: it would go on to hold its locks and write its files."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != owner:  # it was gone before
        os._exit(1)


def _asked(questions: Connection) -> Iterator[tuple[Callable[..., Any], list[tuple[int, tuple[Any, ...]]]]]:
    while True:
        yield pickle.loads(questions.recv_bytes())


def _answer(items: Sequence[Any], function: Callable[..., Any], tasks: Sequence[tuple[int, Any]]) -> bytes:
    try:
        return pickle.dumps([(i, function(items[i], *given)) for i, given in tasks], pickle.HIGHEST_PROTOCOL)
    except (InputError, DivergenceError, WriteError, MemoryError) as error:
        return pickle.dumps(error)
    except Exception as error:
        return pickle.dumps(RuntimeError(f"{error}\n{traceback.format_exc()}"))


def _end(owner: int, ends: Sequence[Connection], pids: Sequence[int]) -> None:
    if os.getpid() != owner:  # a copy of another one
        return
    for end in ends:
        end.close()
    for pid in pids:
        with suppress(ProcessLookupError, ChildProcessError):
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
