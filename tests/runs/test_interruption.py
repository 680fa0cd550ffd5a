"""Signals outside of a training: at once, with handlers put back, and never twice too late."""

import os
import signal
import subprocess
import sys
import time

import pytest

from pinn_cli.runs import interruption
from pinn_cli.runs.interruption import Interruption, watched


def test_elsewhere_a_signal_stops_at_once_and_handlers_are_put_back():
    before = [signal.getsignal(number) for number in interruption.SIGNALS]

    def stopped() -> None:
        with watched():
            os.kill(os.getpid(), signal.SIGTERM)
            pytest.fail("went on")

    with pytest.raises(Interruption):
        stopped()
    assert [signal.getsignal(number) for number in interruption.SIGNALS] == before


def test_ctrl_c_while_the_program_imports_is_one_line(tmp_path):
    (tmp_path / "omegaconf.py").write_text("import time\nprint('importing', flush=True)\ntime.sleep(60)")
    command, path = [sys.executable, "-m", "pinn_cli"], f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env={**os.environ, "PYTHONPATH": path}, **pipes) as process:
        assert process.stdout.readline() == "importing\n"
        process.send_signal(signal.SIGINT)
        assert process.communicate() == ("", "pinn-run: interrupted\n")
    assert process.returncode == 130


def test_an_error_that_a_signal_led_to_is_no_error():
    """Libraries whose import is broken off raise anything."""

    def broken_off() -> None:
        with watched():
            try:
                os.kill(os.getpid(), signal.SIGINT)
            except Interruption:
                raise AttributeError("half imported") from None

    with pytest.raises(Interruption, match="SIGINT"):
        broken_off()


def test_an_ignored_signal_stays_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with watched():
            os.kill(os.getpid(), signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_second_ctrl_c_does_not_wait_for_the_step():
    code = """
import os, signal
from pinn_cli.runs.interruption import deferred, watched
signal.signal(signal.SIGINT, signal.default_int_handler)
with watched(), deferred():
    os.kill(os.getpid(), signal.SIGTERM)
    os.kill(os.getpid(), signal.SIGTERM)
    os.kill(os.getpid(), signal.SIGINT)
    print("still here", flush=True)
    os.kill(os.getpid(), signal.SIGINT)
    print("and here", flush=True)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (-signal.SIGINT, "still here\n")


LONG = {
    "a step that is put off": """
with deferred():
    until = time.monotonic() + 60
    while time.monotonic() < until:
        sum(range(1000))
""",
    "one call of a library": "hashlib.pbkdf2_hmac('sha512', b'', b'', 2**31 - 1)\n",
}


@pytest.mark.parametrize("block", LONG.values(), ids=LONG.keys())
def test_nothing_holds_a_signal_up_for_long(block: str) -> None:
    code = "import hashlib, sys, time\nfrom pinn_cli.runs.interruption import Interruption, deferred, watched\n"
    code += "def run():\n  with watched(in_time=True):\n    print('in', flush=True)\n"
    code += "".join(f"    {line}\n" for line in block.strip().splitlines())
    code += "try:\n  run()\nexcept Interruption as stop:\n  sys.exit(stop.status)\n"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "in\n"
    time.sleep(0.3)
    began = time.monotonic()
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=60) == 143
    assert time.monotonic() - began < 5.0
