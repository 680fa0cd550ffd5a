"""How far a sweep is, read off its jobs' directories: the same for every launcher, here or on another machine."""

from __future__ import annotations

import importlib
import sys
import threading
import time
from pathlib import Path
from typing import Any

from pinn_cli.runs.reading import printable
from pinn_cli.runs.resume import RESULT
from pinn_cli.sweep.failure import FILE, Failure
from pinn_cli.sweep.jobs import Sweep

EVERY_S = 1.0


class Progress:
    """A bar on a terminal, or a line per job that ends, until it is stopped. It looks on and disturbs nothing.

    Args:
        sweep: What to watch; a sweep whose jobs only its sweeper knows is not watched.
    """

    def __init__(self, sweep: Sweep) -> None:
        self._waiting = {name: sweep.directory / name for name in sweep.expected}
        self._total = len(self._waiting)
        self._failed = 0
        self._since = time.time()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="progress", daemon=True)
        self._bar: Any = None

    def start(self) -> None:
        """Show where the sweep begins and watch it from now on; what failed before is run again."""
        if not self._total:
            return
        before = [name for name, place in self._waiting.items() if (place / RESULT).is_file()]
        for name in before:
            del self._waiting[name]
        if before:
            print(f"{len(before)} of {self._total} jobs are finished already", file=sys.stderr)
        if sys.stderr.isatty():
            from tqdm import tqdm

            self._bar = tqdm(total=self._total, initial=len(before), unit="job", dynamic_ncols=True)
        self._thread.start()

    def stop(self) -> None:
        """Look once more, and no more."""
        if not self._thread.is_alive():
            return
        self._stop.set()
        self._thread.join()
        self._look()
        if self._bar is not None:
            self._bar.close()

    def _watch(self) -> None:
        while not self._stop.wait(EVERY_S):
            self._look()
            if 2 * len(self._waiting) <= self._total:  # two seconds that the end of the sweep would take otherwise
                importlib.import_module("pinn_cli.sweep.summary")

    def _look(self) -> None:
        for name, place in list(self._waiting.items()):
            if any(self._is_new(place / file) for file in (RESULT, FILE)):
                del self._waiting[name]
                self._tell(name, place)

    def _is_new(self, file: Path) -> bool:
        """Whether it was written since; what is left of an earlier start is not."""
        try:
            return file.stat().st_mtime >= self._since - 1.0
        except OSError:
            return False

    def _tell(self, name: str, place: Path) -> None:
        failure = Failure.read(place)
        self._failed += failure is not None
        ended = "finished" if failure is None else f"failed: {printable(failure.reason)}"
        if self._bar is None:
            print(f"{self._total - len(self._waiting)} of {self._total}  {printable(name)}  {ended}", file=sys.stderr)
            return
        if failure is not None:
            self._bar.write(f"{name}  {ended}", file=sys.stderr)
        self._bar.set_postfix({"failed": self._failed} if self._failed else {})
        self._bar.update()
