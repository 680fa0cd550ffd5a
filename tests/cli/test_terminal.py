"""What is printed of files that may be anybody's."""

import logging
from pathlib import Path

import pytest

from pinn_cli.cli.command_line import Terminal
from pinn_cli.runs.claim import RunLog
from pinn_cli.sweep.jobs import DEFECT, Failure, Sweep
from pinn_cli.sweep.running import Progress


def test_no_control_character_reaches_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    reason = "\x1b]0;title\x07\x1b[2Jå\u202e\x9b31m µ\r\nm\tN"
    Terminal().say(reason)
    Terminal().complain(reason)
    captured = capsys.readouterr()
    shown = "\\x1b]0;title\\x07\\x1b[2Jå\\u202e\\x9b31m µ"
    assert captured.out == f"{shown}\\r\nm\tN\n"
    assert captured.err == f"pinn-run: {shown} m N\n"


def test_nor_through_a_log(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    log, run_log = logging.getLogger("pinn_cli.test"), RunLog()
    run_log.attach()
    log.warning("%s is gone", "\x1b[2J")
    run_log.open(tmp_path / "pinn-run.log")
    run_log.close()
    assert caplog.messages == ["\\x1b[2J is gone"]
    assert (tmp_path / "pinn-run.log").read_text().endswith("\\x1b[2J is gone\n")
    log.warning("\x1b")  # what a process logs afterwards is its own
    assert caplog.messages[-1] == "\x1b"


def test_nor_by_the_progress_of_a_sweep(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    progress = Progress(Sweep(tmp_path, (), {"seed=0": ("seed=0",)}, is_search=False), 0.0)
    Failure(DEFECT, "\x1b[2J", "").write(tmp_path / "seed=0", [])
    progress.stop()
    assert capsys.readouterr().err == "1 of 1  seed=0  failed: \\x1b[2J\n"
