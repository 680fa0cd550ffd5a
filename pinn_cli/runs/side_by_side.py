"""Work on several items alike, such as records: one after the other, or side by side on the cores.

Threads would wait for each other: much of the work are short steps of Python. So the items are shared out among forked
copies of this process, which stay as long as what holds them does: what a function changes of an item stays changed
there, and there alone. Every item's numbers are computed in the same way wherever that is, and come in the items'
order: they do not depend on how many cores there are.

`concurrent.futures` does not carry this: a question to one of its processes took ten times as long as to one behind a
pipe, the interpreter waited for a busy one at its end, and one whose owner was killed stayed for ever (Python 3.11).
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
from dataclasses import dataclass
from itertools import count
from multiprocessing import Process, current_process, get_context
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

from pinn_cli.runs.process import usable_cores
from pinn_cli.runs.writing import WriteError
from pinn_cli.settings.errors import DivergenceError, InputError

R = TypeVar("R")
T = TypeVar("T")

# Of Linux's prctl; and how much less of a busy core such copies take: two thirds of what this process does.
_PR_SET_PDEATHSIG, _BEHIND = 1, 2


class Items(Generic[T]):
    """Items that are worked on in this process, one after the other.

    Attributes:
        held: They, as arguments of :meth:`map`.
    """

    def __init__(self, items: Sequence[T]) -> None:
        self.items = list(items)
        self.held: list[Any] = self.items
        self.close: Callable[[], object] = lambda: None  # ends what works on them, whatever it is about

    def each(self, function: Callable[..., R], *arguments: Sequence[Any]) -> list[R]:
        """What a function makes of every item, in their order; each further argument has one entry for every item."""
        return self.begin(function, *arguments)()

    def begin(self, function: Callable[..., R], *arguments: Sequence[Any]) -> Callable[[], list[R]]:
        """Begin with what :meth:`each` does; what is returned waits for the answers, and is to be called."""
        return lambda: self.map(function, self.held, *arguments)

    def map(self, function: Callable[..., R], *arguments: Sequence[Any]) -> list[R]:
        """What a function of a file makes of arguments where the items are; each has one entry for every item."""
        return [function(*given) for given in zip(*arguments, strict=True)]

    def keep(self, function: Callable[..., Any], *arguments: Sequence[Any]) -> list[Any]:
        """What :meth:`map` makes, which stays with the items: as an argument it is there what it was."""
        return self.map(function, *arguments)


@dataclass(frozen=True)
class Kept:
    """Something that a copy keeps under this number, for as long as the object lives that :meth:`keep` returned."""

    number: int


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
        self.shares = shared_out([1] * len(items) if sizes is None else sizes, copies)
        self.held = [Kept(i) for i in range(len(items))]
        self._numbers, self._forgotten = count(len(items)), list[int]()
        self.ends: list[Connection] = []
        fork, processes = get_context("fork"), list[Process]()
        self.close = weakref.finalize(self, _end, os.getpid(), self.ends, processes)
        for _ in self.shares:
            mine, its = fork.Pipe()
            # Of a daemon no process waits for the end.
            copy = fork.Process(target=_serve, args=(self.items, its, [mine, *_ends], os.getpid(), behind), daemon=True)
            copy.start()
            its.close()
            _ends.add(mine)
            self.ends.append(mine)
            processes.append(copy)  # type: ignore[arg-type]

    def begin(self, function: Callable[..., R], *arguments: Sequence[Any]) -> Callable[[], list[R]]:
        """See :meth:`Items.begin`; what the copies do meanwhile goes on at once."""
        return self._ask(function, (self.held, *arguments), [None] * len(self.items))

    def map(self, function: Callable[..., R], *arguments: Sequence[Any]) -> list[R]:
        """See :meth:`Items.map`."""
        return self._ask(function, arguments, [None] * len(self.items))()

    def keep(self, function: Callable[..., Any], *arguments: Sequence[Any]) -> list[Any]:
        """See :meth:`Items.keep`."""
        kept = [Kept(next(self._numbers)) for _ in self.items]
        for item in kept:
            weakref.finalize(item, self._forgotten.append, item.number).atexit = False
        self._ask(function, arguments, [item.number for item in kept])()
        return kept

    def _ask(
        self, function: Callable[..., Any], arguments: Sequence[Sequence[Any]], numbers: Sequence[int | None]
    ) -> Callable[[], list[Any]]:
        """Ask the copies, and tell them what to forget; what has a number is kept. What is returned waits for it."""
        tasks = list(zip(range(len(self.items)), zip(*arguments, strict=True), numbers, strict=True))
        forgotten = [self._forgotten.pop() for _ in range(len(self._forgotten))]
        with self._answering():
            for end, share in zip(self.ends, self.shares, strict=True):
                end.send_bytes(pickle.dumps((function, [tasks[i] for i in share], forgotten), pickle.HIGHEST_PROTOCOL))
        return self._answers

    def _answers(self) -> list[Any]:
        answers: dict[int, Any] = {}
        with self._answering():
            for end in self.ends:
                answer = pickle.loads(end.recv_bytes())
                if isinstance(answer, BaseException):
                    raise answer
                answers.update(answer)
        return [answers[i] for i in range(len(self.items))]

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


def side_by_side(items: Sequence[T], sizes: Sequence[int] | None = None) -> Items[T]:
    """Items on as many cores as there are; ``sizes``: of the work on each, None: all alike."""
    copies = min(len(items), len(usable_cores()))
    return SharedOutItems(items, copies, sizes) if copies > 1 and _can_copy() else Items(items)


def in_a_copy(item: T) -> Items[T]:
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


def _serve(items: Sequence[Any], questions: Connection, others: Sequence[Connection], owner: int, behind: bool) -> None:
    """What a copy does until nobody asks any more."""
    try:
        # Linux kills it when its owner is gone: it would go on to hold its locks and write its files.
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != owner:  # it was gone before
            return
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one that asks
        for number in (signal.SIGTERM, signal.SIGALRM):
            signal.signal(number, signal.SIG_DFL)
        current_process().daemon = False  # it may have copies of its own
        for other in others:
            other.close()
        os.nice(_BEHIND if behind else 0)
        gc.freeze()
        if "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(1)  # other threads are not copied
        kept = dict(enumerate(items))
        with suppress(EOFError, BrokenPipeError):
            while True:
                function, tasks, forgotten = pickle.loads(questions.recv_bytes())
                for gone in forgotten:
                    kept.pop(gone, None)
                questions.send_bytes(_answer(kept, function, tasks))
    finally:
        os._exit(0)  # and not through what this process was about to do at its end


def _answer(
    kept: dict[int, Any], function: Callable[..., Any], tasks: Sequence[tuple[int, tuple[Any, ...], int | None]]
) -> bytes:
    """Of every task, the item's place, the arguments, and the number to keep the answer under; None: it is sent."""
    try:
        answers = []
        for i, given, number in tasks:
            answer = function(*(kept[value.number] if isinstance(value, Kept) else value for value in given))
            answers.append((i, answer if number is None else kept.update({number: answer})))
        return pickle.dumps(answers, pickle.HIGHEST_PROTOCOL)
    except (InputError, DivergenceError, WriteError, MemoryError) as error:
        return pickle.dumps(error)
    except Exception as error:
        return pickle.dumps(RuntimeError(f"{error}\n{traceback.format_exc()}"))


def _end(owner: int, ends: Sequence[Connection], processes: Sequence[Process]) -> None:
    if os.getpid() != owner:  # a copy of another one
        return
    for end in ends:
        end.close()
    for process in processes:
        process.kill()
        process.join()
