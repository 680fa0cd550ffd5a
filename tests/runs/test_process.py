"""The process of a run: signals outside of a training, seconds by stage, signs of life; and copies of it."""

import os
import signal
import subprocess
import sys
import time

import pytest
from interrupted_runs import gone

from pinn_cli.runs import interruption
from pinn_cli.runs import side_by_side as page
from pinn_cli.runs.interruption import Interruption, watched
from pinn_cli.runs.side_by_side import Items, Kept, SharedOutItems, shared_out, side_by_side
from pinn_cli.runs.stages import Stages, signs_of_life
from pinn_cli.runs.writing import WriteError
from pinn_cli.settings.errors import DivergenceError, InputError


def test_elsewhere_a_signal_stops_at_once_and_handlers_are_put_back():
    before = [signal.getsignal(number) for number in interruption.SIGNALS]

    def stopped() -> None:
        with watched():
            os.kill(os.getpid(), signal.SIGTERM)
            pytest.fail("went on")

    with pytest.raises(Interruption):
        stopped()
    assert [signal.getsignal(number) for number in interruption.SIGNALS] == before

    # Libraries whose import is broken off raise anything.
    def broken_off() -> None:
        with watched():
            try:
                os.kill(os.getpid(), signal.SIGINT)
            except Interruption:
                raise AttributeError("half imported") from None

    with pytest.raises(Interruption, match="SIGINT"):
        broken_off()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with watched():
            os.kill(os.getpid(), signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def test_ctrl_c_while_the_program_imports_is_one_line(tmp_path):
    (tmp_path / "omegaconf.py").write_text("import time\nprint('importing', flush=True)\ntime.sleep(60)")
    command, path = [sys.executable, "-m", "pinn_cli"], f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env={**os.environ, "PYTHONPATH": path}, **pipes) as process:
        assert process.stdout.readline() == "importing\n"
        process.send_signal(signal.SIGINT)
        assert process.communicate() == ("", "pinn-run: interrupted\n")
    assert process.returncode == 130


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


def test_stages_add_up_from_the_run_s_beginning() -> None:
    stages = Stages()
    for _ in range(2):
        with stages("record"):
            time.sleep(0.01)
    assert 0.02 <= stages.seconds["record"] <= stages.seconds["total"]
    assert list(stages.seconds) == ["record", "total", "processor"]
    stages = Stages(time.perf_counter() - 5.0)
    stages.reached("table_at")
    seconds = stages.seconds
    assert list(seconds) == ["start_up", "table_at", "total", "processor"]
    assert 5.0 <= seconds["start_up"] <= seconds["table_at"] <= seconds["total"] < 6.0


def test_the_stage_and_the_seconds_are_told_less_and_less_often(caplog: pytest.LogCaptureFixture) -> None:
    stages = Stages()
    with signs_of_life(stages, first_s=0.05), stages("record"), stages("imports"):
        time.sleep(0.5)
    told = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert 2 <= len(told) <= 3  # after 0.05, 0.15 and 0.35 s
    assert all(text == "still running after 0 s, now in imports" for text in told)
    time.sleep(0.1)
    assert len([record for record in caplog.records if record.levelname == "WARNING"]) == len(told)


IMPORTING = """
import gc
from pinn_cli.runs.process import collect_rarely, keep_imported
usual = gc.get_threshold()
collect_rarely()
rarely = gc.get_threshold()
kept = [[] for _ in range(1000)]
keep_imported()
print(rarely[0] > 10 * usual[0], gc.get_threshold() == usual, gc.get_freeze_count() >= 1000)
before = gc.get_freeze_count()
more = [[] for _ in range(1000)]
collect_rarely()
keep_imported()
print(gc.get_threshold() == usual, gc.get_freeze_count() == before)
"""


def test_imported_objects_are_not_looked_through_and_later_ones_are() -> None:
    said = subprocess.run([sys.executable, "-c", IMPORTING], capture_output=True, check=True, text=True).stdout
    assert said.split() == ["True"] * 5


pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system copies no process")


def size_and_process(size: int, more: int) -> tuple[int, int]:
    return size + more, os.getpid()


def niceness(_item: object, _more: int) -> int:
    return os.nice(0)


def end_itself(item: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fail(item: object, error: Exception | None) -> int:
    if error is not None:
        raise error
    return 1


@pytest.mark.parametrize("copies", [2, 3])
def test_answers_come_in_the_order_of_the_items(copies):
    answers = SharedOutItems((5, 50, 7, 9), copies).each(size_and_process, (1, 2, 3, 4))
    assert [size for size, _ in answers] == [6, 52, 10, 13]
    processes = {process for _, process in answers}
    assert len(processes) == copies
    assert os.getpid() not in processes
    assert Items((5, 50)).each(size_and_process, (1, 2)) == [(6, os.getpid()), (52, os.getpid())]


def counted(item: int, *others: object) -> list[object]:
    return [item, *others]


@pytest.mark.parametrize("copied", [False, True])
def test_what_is_kept_is_there_what_it_was(copied):
    items = SharedOutItems((5, 50), 2) if copied else Items((5, 50))
    kept = items.keep(counted, items.held, ("a", "b"))
    assert items.map(counted, kept, (1, 2)) == [[[5, "a"], 1], [[50, "b"], 2]]
    assert items.each(counted, kept) == [[5, [5, "a"]], [50, [50, "b"]]]


def test_what_nobody_holds_is_forgotten():
    shared = SharedOutItems((5, 50), 2)
    kept = shared.keep(counted, shared.held)
    same = Kept(kept[0].number), Kept(kept[1].number)
    assert shared.map(len, same) == [1, 1]
    del kept
    with pytest.raises(RuntimeError, match="KeyError"):
        shared.map(len, same)


@pytest.mark.parametrize(
    "error",
    [
        DivergenceError("not finite"),
        InputError("system.ndof", 3, "fewer", "too much memory"),
        WriteError("response.png", "No space left on device"),
        MemoryError(),
    ],
)
def test_an_error_comes_back_as_it_is(error):
    shared = SharedOutItems((1, 1), 2)
    with pytest.raises(type(error)) as raised:
        shared.each(fail, (None, error))
    assert str(raised.value) == str(error)


def test_a_defect_comes_back_with_its_place_and_a_copy_that_was_killed_is_told():
    with pytest.raises(RuntimeError, match="in fail"):
        SharedOutItems((1, 1), 2).each(fail, (ZeroDivisionError("odd"), None))
    with pytest.raises(MemoryError, match="killed"):
        SharedOutItems((1, 1), 2).each(end_itself)


def processes_of(shared: SharedOutItems) -> list[int]:
    return [process for _, process in shared.each(size_and_process, (0, 0))]


def test_copies_end_with_what_they_are_copies_of():
    shared, other = SharedOutItems((1, 1), 2), SharedOutItems((1, 1), 2)
    first, second = processes_of(shared), processes_of(other)
    del shared
    assert all(map(gone, first))
    assert not any(map(gone, second))
    assert processes_of(other) == second


def note(item: list[int], number: int) -> list[int]:
    item.append(number)
    return item


def test_what_changes_of_an_item_stays_changed_with_its_copy():
    items = [[0], [1], [2]]
    shared = SharedOutItems(items, 2, sizes=(3, 2, 1))
    assert shared.shares == [[0], [1, 2]]  # of about the same size
    assert shared_out([1, 10, 2, 9], 2) == [[0, 1], [2, 3]]
    assert shared_out([1] * 8, 2) == [[0, 2, 4, 6], [1, 3, 5, 7]]
    shared.each(note, (5, 6, 7))
    assert shared.each(note, (8, 8, 8)) == [[0, 5, 8], [1, 6, 8], [2, 7, 8]]
    assert items == [[0], [1], [2]]


def test_one_core_or_what_cannot_be_copied_stays_here(monkeypatch):
    monkeypatch.setattr(page, "usable_cores", lambda: [0])
    assert type(side_by_side((1, 1, 1))) is Items
    monkeypatch.setattr(page, "usable_cores", lambda: [0, 1])
    assert type(side_by_side((1,))) is Items
    assert len(side_by_side((1, 1, 1)).shares) == 2


def test_copies_work_while_this_process_does_something_else():
    shared = SharedOutItems((1, 2), 2, behind=True)
    answers = shared.begin(size_and_process, (1, 1))
    assert [size for size, _ in answers()] == [2, 3]
    assert shared.each(niceness, (0, 0))[0] >= min(os.nice(0) + 1, 19)
    late = Items((1, 2)).begin(size_and_process, (1, 1))
    assert [size for size, _ in late()] == [2, 3]


def sleep(_item: object) -> None:
    time.sleep(30.0)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux tells of a parent's death")
def test_copies_end_with_a_process_that_is_killed():
    said, told = os.pipe()
    owner = os.fork()
    if owner == 0:
        later, shared = (SharedOutItems((1, 2), 2) for _ in range(2))  # which holds no end of the earlier one's pipe
        processes = processes_of(shared) + processes_of(later)
        shared.begin(sleep)
        os.write(told, " ".join(map(str, processes)).encode())
        time.sleep(30.0)
        os._exit(0)
    processes = [int(process) for process in os.read(said, 100).split()]
    os.kill(owner, signal.SIGKILL)
    os.waitpid(owner, 0)
    until = time.monotonic() + 5.0
    while not all(map(gone, processes)) and time.monotonic() < until:
        time.sleep(0.01)
    assert len(processes) == 4
    assert all(map(gone, processes))


@pytest.mark.parametrize("cores", [1, 2])
def test_one_item_has_a_copy_where_there_is_a_core_to_spare(cores, monkeypatch):
    monkeypatch.setattr(page, "usable_cores", lambda: list(range(cores)))
    ((size, process),) = page.in_a_copy(5).each(size_and_process, (1,))
    assert size == 6
    assert (process == os.getpid()) == (cores == 1 or not sys.platform.startswith("linux"))
