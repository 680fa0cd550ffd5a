"""What is printed of files that may be anybody's."""

from __future__ import annotations

import pytest

from pinn_cli.cli.terminal import Terminal


def test_no_control_character_reaches_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    reason = "\x1b]0;title\x07\x1b[2Jå\u202e\x9b31m µ\r\nm\tN"
    Terminal().say(reason)
    Terminal().complain(reason)
    captured = capsys.readouterr()
    shown = "\\x1b]0;title\\x07\\x1b[2Jå\\u202e\\x9b31m µ"
    assert captured.out == f"{shown}\\r\nm\tN\n"
    assert captured.err == f"pinn-run: {shown} m N\n"
