"""Which cores this process may use."""

from __future__ import annotations

import os


def usable_cores() -> list[int]:
    """Those that this process may run on."""
    affinity = getattr(os, "sched_getaffinity", None)
    return sorted(affinity(0)) if affinity else list(range(os.cpu_count() or 1))
