"""Where a run's time goes, and what it says of itself while it takes long."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

log = logging.getLogger(__name__)

# Seconds to the first line and, as each next one waits twice as long, from one to the next at most.
FIRST_S, MOST_S = 20.0, 600.0


class Stages:
    """Wall-clock seconds by stage and the processor's in all, for run.json and, as they end, for the log.

    The run ``began`` at that time of `time.perf_counter`; None: now. What has passed since is its ``start_up``.

    Example:
        >>> stages = Stages()
        >>> with stages("record"):
        ...     pass
        >>> list(stages.seconds)
        ['record', 'total', 'processor']
    """

    def __init__(self, began: float | None = None) -> None:
        now = time.perf_counter()
        self._start = now if began is None else began
        # A run that has the process to itself counts the start-up as well.
        self._processor = time.process_time() if began is None else 0.0
        self._seconds: dict[str, float] = {} if began is None else {"start_up": now - began}
        self._moments: dict[str, float] = {}
        self._entered: list[str] = []

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time a block; a stage that comes twice is added up."""
        start = time.perf_counter()
        self._entered.append(name)
        try:
            yield
        finally:
            self._entered.pop()
            seconds = time.perf_counter() - start
            self._seconds[name] = self._seconds.get(name, 0.0) + seconds
            log.info("%s: %.2f s", name, seconds)

    def reached(self, moment: str) -> None:
        """Note that something happens now, such as ``table_at``: seconds since the run began."""
        self._moments[moment] = time.perf_counter() - self._start

    @property
    def current(self) -> str:
        """The stage that lasts, of nested ones the innermost; empty between stages."""
        entered = self._entered.copy()  # read by another thread
        return entered[-1] if entered else ""

    @property
    def seconds(self) -> dict[str, float]:
        """Stage to seconds; the moments that were reached, the total and the processor's time, since the run began."""
        total = {"total": time.perf_counter() - self._start, "processor": time.process_time() - self._processor}
        return {**self._seconds, **self._moments, **total}


@contextmanager
def signs_of_life(stages: Stages, first_s: float = FIRST_S) -> Iterator[None]:
    """Log a warning, which the terminal shows, now and then while the block lasts, first after so many seconds."""
    over = threading.Event()

    def tell() -> None:
        begun, wait = time.monotonic(), first_s
        while not over.wait(wait):
            where = f", now in {stages.current}" if stages.current else ""
            log.warning("still running after %.0f s%s", time.monotonic() - begun, where)
            wait = min(2.0 * wait, MOST_S)

    teller = threading.Thread(target=tell, name="signs of life", daemon=True)
    teller.start()
    try:
        yield
    finally:
        over.set()
        teller.join()
