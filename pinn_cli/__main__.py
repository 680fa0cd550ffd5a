"""The command as the shell starts it: Ctrl-C while it still imports ends it in one line, too."""

from __future__ import annotations

import os
import signal
from types import FrameType

STATUS_INTERRUPTED = 130


def _end(number: int, frame: FrameType | None) -> None:
    os.write(2, b"pinn-run: interrupted\n")
    os._exit(STATUS_INTERRUPTED)


def main() -> None:
    """:func:`pinn_cli.main.main`, once it is imported; what listens to signals meanwhile takes this one's place."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not under nohup
        signal.signal(signal.SIGINT, _end)
    from pinn_cli.main import main as command

    command()


if __name__ == "__main__":
    main()
