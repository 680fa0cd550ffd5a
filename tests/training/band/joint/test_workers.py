"""Parts of several records in copies of the process."""

from __future__ import annotations

import os
import signal
import time
from types import SimpleNamespace

import pytest
import torch

from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.training.band.joint import workers
from pinn_cli.training.band.joint.member import Member
from pinn_cli.training.band.joint.workers import Members, SharedOutMembers, shared_out

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system copies no process")


def members(sizes: tuple[int, ...]) -> list[Member]:
    """Stand-ins that know their size, which is all that sharing them out asks for."""
    target = SimpleNamespace(force=torch.zeros(1))
    layouts = [SimpleNamespace(layout=SimpleNamespace(size=size), target=target) for size in sizes]
    return [Member(SimpleNamespace(equations=equations)) for equations in layouts]


def size_and_process(member: Member, more: int) -> tuple[int, int]:
    return member.evidence.equations.layout.size + more, os.getpid()


def fail(member: Member, error: Exception | None) -> int:
    if error is not None:
        raise error
    return 1


def end_itself(member: Member) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize("copies", [2, 3])
def test_answers_come_in_the_order_of_the_members(copies):
    shared = SharedOutMembers(members((5, 50, 7, 9)), copies)
    answers = shared.each(size_and_process, (1, 2, 3, 4))
    assert [size for size, _ in answers] == [6, 52, 10, 13]
    processes = {process for _, process in answers}
    assert len(processes) == copies
    assert os.getpid() not in processes
    assert Members(members((5, 50))).each(size_and_process, (1, 2)) == [(6, os.getpid()), (52, os.getpid())]


def test_shares_are_of_about_the_same_size():
    assert shared_out([1, 10, 2, 9], 2) == [[0, 1], [2, 3]]
    assert shared_out([1, 1, 1, 1, 1, 1, 1, 1], 2) == [[0, 2, 4, 6], [1, 3, 5, 7]]
    assert shared_out([100, 1, 1, 1], 2) == [[0], [1, 2, 3]]


@pytest.mark.parametrize(
    "error", [DivergenceError("not finite"), InputError("system.ndof", 3, "fewer", "too much memory"), MemoryError()]
)
def test_an_error_comes_back_as_it_is(error):
    shared = SharedOutMembers(members((1, 1)), 2)
    with pytest.raises(type(error)) as raised:
        shared.each(fail, (None, error))
    assert str(raised.value) == str(error)


def test_a_defect_comes_back_with_its_place():
    with pytest.raises(RuntimeError, match="in fail"):
        SharedOutMembers(members((1, 1)), 2).each(fail, (ZeroDivisionError("odd"), None))


def test_a_copy_that_was_killed_is_told():
    shared = SharedOutMembers(members((1, 1)), 2)
    with pytest.raises(MemoryError, match="killed"):
        shared.each(end_itself)


def processes_of(shared: SharedOutMembers) -> list[int]:
    return [process for _, process in shared.each(size_and_process, (0, 0))]


def gone(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    return False


def test_copies_end_with_what_they_are_copies_of():
    shared, other = SharedOutMembers(members((1, 1)), 2), SharedOutMembers(members((1, 1)), 2)
    first, second = processes_of(shared), processes_of(other)
    del shared
    assert all(map(gone, first))
    assert not any(map(gone, second))
    assert processes_of(other) == second


def test_copies_end_with_the_process_however_it_ends():
    """Those that were made later hold no end of an earlier one's pipe."""
    mine, its = os.pipe()
    child = os.fork()
    if child == 0:
        kept = [SharedOutMembers(members((1, 1)), 2) for _ in range(2)]
        os.write(its, " ".join(str(p) for shared in kept for p in processes_of(shared)).encode())
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    processes = [int(p) for p in os.read(mine, 1000).split()]
    assert len(processes) == 4
    deadline = time.monotonic() + 5.0
    while not all(map(gone, processes)) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert all(map(gone, processes))


def test_one_core_or_a_gpu_copies_nothing(monkeypatch):
    evidence = [member.evidence for member in members((1, 1, 1))]
    monkeypatch.setattr(workers, "usable_cores", lambda: [0])
    assert type(workers.members_of(evidence)) is Members
    monkeypatch.setattr(workers, "usable_cores", lambda: [0, 1])
    assert len(workers.members_of(evidence).shares) == 2
    evidence[0].equations.target.force = SimpleNamespace(device=SimpleNamespace(type="cuda"))
    assert type(workers.members_of(evidence)) is Members
