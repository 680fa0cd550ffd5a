"""How much memory there is, and how Python takes it back. Nothing slow is imported here."""

from __future__ import annotations

import atexit
import gc
import os
from functools import cache

# New objects after which Python looks for garbage: as it comes, and while libraries are imported.
_USUAL, _NEW_OBJECTS = gc.get_threshold()[0], 50_000
# Where the system does not tell, bytes.
_UNTOLD = 2**40


def of_this_machine() -> int:
    """All its memory, bytes."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return _UNTOLD


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an exception says that there is no memory left: torch has none of its own for that on the CPU."""
    return isinstance(error, MemoryError) or "can't allocate memory" in str(error) or "out of memory" in str(error)


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


@cache  # once is enough, however many jobs a process runs
def leave_without_collecting() -> None:
    """Have the process not look for garbage when it ends, which takes half a second after torch is imported.

    The system takes all memory back anyway; files are closed by those who opened them.
    """
    atexit.register(gc.freeze)
