"""`pinn-run.log`: what a run says before its directory is its own waits in memory."""

from __future__ import annotations

import logging
from contextlib import suppress
from pathlib import Path
from typing import TextIO

FORMAT = "[%(asctime)s][%(name)s][%(levelname)s] %(message)s"


class RunLog(logging.Handler):
    """A log that is kept in memory until it has a file. A disk that takes no more ends no run: lines are then lost."""

    def __init__(self) -> None:
        super().__init__()
        self.setFormatter(logging.Formatter(FORMAT))
        self._waiting: list[str] = []
        self._file: TextIO | None = None

    def attach(self) -> None:
        """Have everything that this process logs come here too."""
        logging.getLogger().addHandler(self)

    def open(self, path: Path) -> None:
        """Append what waits, and from now on every line.

        Raises:
            OSError: The file cannot be opened.
        """
        self._file = path.open("a", encoding="utf-8")
        for line in self._waiting:
            self._write(line)
        self._waiting.clear()

    def emit(self, record: logging.LogRecord) -> None:
        """See :class:`logging.Handler`."""
        line = self.format(record)
        if self._file is None:
            self._waiting.append(line)
        else:
            self._write(line)

    def close(self) -> None:
        """Close the file and hear no more."""
        logging.getLogger().removeHandler(self)
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            self._file = None
        super().close()

    def _write(self, line: str) -> None:
        if self._file is not None:
            with suppress(OSError):
                self._file.write(f"{line}\n")
                self._file.flush()
