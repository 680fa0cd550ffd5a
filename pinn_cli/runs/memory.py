"""How much memory there is, and how the C library and Python take it back. Nothing slow is imported here."""

from __future__ import annotations

import atexit
import ctypes
import gc
import os
import sys
from functools import cache

# glibc's mallopt: from this size on, blocks are mapped one by one (32 MiB is the most that it takes); and how much free
# memory at the end of the heap is kept.
_M_MMAP_THRESHOLD, _M_TRIM_THRESHOLD = -3, -1
_LARGEST_BLOCK, _KEPT = 32 * 2**20, 2**31 - 1
_USUAL_THRESHOLD = 128 * 2**10  # of both
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


def keep_freed_memory() -> None:
    """Have freed blocks used again rather than given back to the system, on glibc; elsewhere nothing happens.

    Residuals and their derivatives are arrays of 0.1 to 30 MiB that come and go by the thousand. Mapped anew, each has
    to be cleared by the kernel page by page: a quarter of the time of Gauss-Newton at 6 DOFs. Peak memory is the same.
    """
    if not sys.platform.startswith("linux"):
        return
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):  # another C library
        return
    mallopt(_M_MMAP_THRESHOLD, _LARGEST_BLOCK)
    mallopt(_M_TRIM_THRESHOLD, _KEPT)


def give_freed_memory_back() -> None:
    """Have the system get freed blocks again, those of :func:`keep_freed_memory` included, as glibc does by default."""
    if not sys.platform.startswith("linux"):
        return
    try:
        library = ctypes.CDLL(None)
        mallopt, trim = library.mallopt, library.malloc_trim
    except (OSError, AttributeError):
        return
    mallopt(_M_MMAP_THRESHOLD, _USUAL_THRESHOLD)
    mallopt(_M_TRIM_THRESHOLD, _USUAL_THRESHOLD)
    trim(0)


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
