"""A worker whose launcher has been killed ends as well: nobody would ever give it another job."""

from __future__ import annotations

import os
import threading
import time

EVERY_S = 1.0
STATUS = 143

_watching = False


def end_with_launcher() -> None:
    """Have this process, a launcher's worker, end within seconds of the process that started it.

    As a kill does: the job under way has its last checkpoint, and goes on when the sweep does. Once in a process is
    enough.
    """
    global _watching  # noqa: PLW0603
    if not _watching:
        _watching = True
        threading.Thread(target=_watch, args=(os.getppid(),), name="launcher", daemon=True).start()


def _watch(launcher: int) -> None:
    while os.getppid() == launcher:
        time.sleep(EVERY_S)
    os._exit(STATUS)
