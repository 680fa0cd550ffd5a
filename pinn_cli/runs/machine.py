"""What this machine has, for this process: cores and memory. Nothing slow is imported here."""

from __future__ import annotations

import os

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
