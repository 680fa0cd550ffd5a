"""What a run says of itself while it takes long: which stage it is in, and for how long it has run."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pinn_cli.runs.stages import Stages

log = logging.getLogger(__name__)

# Seconds to the first line and, as each next one waits twice as long, from one to the next at most.
FIRST_S, MOST_S = 20.0, 600.0


@contextmanager
def signs_of_life(stages: Stages, first_s: float = FIRST_S) -> Iterator[None]:
    """Log a warning, which the terminal shows, every now and then while the block lasts.

    Args:
        stages: Of the run.
        first_s: Seconds to the first line.
    """
    over = threading.Event()

    def tell() -> None:
        begun, wait = time.monotonic(), first_s
        while not over.wait(wait):
            log.warning("still running after %.0f s, now in %s", time.monotonic() - begun, stages.current or "no stage")
            wait = min(2.0 * wait, MOST_S)

    teller = threading.Thread(target=tell, name="signs of life", daemon=True)
    teller.start()
    try:
        yield
    finally:
        over.set()
        teller.join()
