"""Two processes in one run's directory: the second waits, and a kill leaves no lock behind."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from calls import PinnRun
from filelock import FileLock

from pinn_cli.runs import lock as run_lock
from pinn_cli.runs.lock import FILE, held

HOLD = """
import sys, time
from pathlib import Path
from pinn_cli.runs.lock import held
with held(Path(sys.argv[1])):
    print("in", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def other(tmp_path: Path):
    """Another process that has the directory."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "in\n"
    yield process
    process.kill()
    process.wait()


def test_nothing_is_left_behind(tmp_path: Path) -> None:
    with held(tmp_path):
        assert f'"pid": {os.getpid()}' in (tmp_path / FILE).read_text()
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="away"), held(tmp_path):
        raise ValueError("away")
    assert not list(tmp_path.iterdir())


def test_the_second_waits_until_the_first_is_killed(other, tmp_path: Path, monkeypatch, caplog) -> None:
    monkeypatch.setattr(run_lock, "EVERY_S", 0.02)
    threading.Timer(0.3, other.send_signal, [signal.SIGKILL]).start()
    start = time.perf_counter()
    with held(tmp_path):
        assert time.perf_counter() - start > 0.25
        assert other.wait() == -signal.SIGKILL
    (told,) = caplog.messages
    assert told.startswith(f"waiting for another process to leave {tmp_path}: ")
    assert f'"pid": {other.pid}' in told


def test_many_come_in_one_by_one(tmp_path: Path, monkeypatch) -> None:
    """Also across the moment at which the one before removes the file."""
    monkeypatch.setattr(run_lock, "EVERY_S", 1e-4)
    inside: list[int] = []
    most: list[int] = []

    def come_in(number: int) -> None:
        for _ in range(30):
            with held(tmp_path):
                inside.append(number)
                most.append(len(inside))
                time.sleep(1e-4)
                inside.remove(number)

    threads = [threading.Thread(target=come_in, args=[number]) for number in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (len(most), max(most)) == (180, 1)
    assert not list(tmp_path.iterdir())


def test_a_file_system_without_locks_is_told_of(tmp_path: Path, monkeypatch, caplog) -> None:
    def refuse(lock: FileLock, **_: object) -> None:
        raise OSError(errno.ENOLCK, "no locks available")

    monkeypatch.setattr(FileLock, "acquire", refuse)
    with held(tmp_path):
        assert not list(tmp_path.iterdir())
    assert "file system without locks" in caplog.text


def test_a_run_waits_for_the_one_in_its_directory(other, tmp_path: Path, monkeypatch, pinn_run: PinnRun) -> None:
    monkeypatch.setattr(run_lock, "EVERY_S", 0.02)
    monkeypatch.setattr(run_lock, "_owner", lambda file: other.terminate())  # asked for once, when it has to wait
    seen: list[bool] = []
    done = pinn_run(f"hydra.run.dir={tmp_path}", task=lambda config: seen.append((tmp_path / FILE).is_file()))
    assert other.wait() == -signal.SIGTERM
    assert (done.status, seen) == (0, [True])
    assert "waiting for another process to leave" in done.err
    assert not (tmp_path / FILE).exists()
