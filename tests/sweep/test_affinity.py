"""Every worker has cores of its own."""

from __future__ import annotations

import multiprocessing
import os

import pytest

from pinn_cli.runs.cores import usable_cores
from pinn_cli.sweep.affinity import jobs_at_once, pin, shares


def test_cores_are_divided() -> None:
    assert shares([0, 1, 2, 3], 2) == [[0, 1], [2, 3]]
    assert shares([0, 1, 5], 2) == [[0], [1, 5]]
    assert shares([4, 7], 3) == [[4], [7], [4]]
    assert shares([2], 1) == [[2]]


def test_jobs_at_once() -> None:
    cores = len(usable_cores())
    assert jobs_at_once(1) == cores
    assert jobs_at_once(cores + 1) == 1


def _pinned(barrier: object, results: object) -> None:
    cores = pin(2)
    again = pin(2)
    barrier.wait(60)  # type: ignore[attr-defined]
    results.put((cores, again))  # type: ignore[attr-defined]


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system does not pin processes")
@pytest.mark.skipif(len(usable_cores()) < 2, reason="there is one core")
def test_siblings_have_different_cores() -> None:
    context = multiprocessing.get_context("fork")
    barrier, results = context.Barrier(2), context.Queue()
    processes = [context.Process(target=_pinned, args=(barrier, results)) for _ in range(2)]
    for process in processes:
        process.start()
    (one, one_again), (other, other_again) = (results.get(timeout=60) for _ in processes)
    for process in processes:
        process.join()
    assert (one, other) == (one_again, other_again)
    assert not set(one) & set(other)
    assert sorted(one + other) == usable_cores()
