"""How many jobs a sweep may have, and which of them stand for all when it is checked."""

from __future__ import annotations

import time
from itertools import product

import pytest
from calls import PinnRun

from pinn_cli.settings.errors import InputError
from pinn_cli.sweep.directories import combinations
from pinn_cli.sweep.grid import representatives


def test_numbers_of_a_setting_are_alike_and_words_are_not() -> None:
    batch = [
        list(job) for job in product([f"seed={n}" for n in range(64)], ["a=1.5e3", "a=-2"], ["system=x", "system=y"])
    ]
    chosen = representatives(batch)
    assert len(chosen) == 2
    assert {override for job in chosen for override in job if override.startswith("system")} == {"system=x", "system=y"}
    assert {override.partition("=")[0] for job in chosen for override in job} == {"seed", "a", "system"}


def test_every_word_is_composed_once() -> None:
    batch = [[f"scheme={scheme}", f"k=[{k}]"] for scheme, k in product("abc", range(4))]
    chosen = representatives(batch)
    assert {override for job in chosen for override in job} == {override for job in batch for override in job}
    assert len(chosen) < len(batch)


def test_nothing() -> None:
    assert representatives([]) == []
    assert representatives([[]]) == []


@pytest.mark.parametrize(
    ("overrides", "jobs"),
    [
        (["a=range(7)", "b=1,2,3"], 21),
        (["a=range(1,2,0.3)", "b=5"], 4),
        (["a=range(5,0,-2)"], 3),
        (["a=shuffle(range(4))", "b=choice(x)"], 4),
        (["a=1,2", "a=range(3)"], 3),
    ],
)
def test_jobs_are_counted_as_they_are_made(overrides: list[str], jobs: int) -> None:
    assert len(combinations(overrides, jobs)) == jobs
    with pytest.raises(InputError, match=f"^a=.*at most {jobs - 1} jobs; there would be {jobs};"):
        combinations(overrides, jobs - 1)


@pytest.mark.parametrize(
    "overrides",
    [["seed=range(0,1000000000)"], ["seed=range(0,1e3,1e-6)"], ["seed=range(2000)", "threads=range(1,2001)"]],
)
def test_a_sweep_of_too_many_jobs_is_refused_at_once(pinn_run: PinnRun, overrides: list[str]) -> None:
    begun = time.process_time()
    refused = pinn_run("--multirun", *overrides)
    assert time.process_time() - begun < 5.0
    assert (refused.status, refused.err.count("\n")) == (2, 1)
    assert "hydra.sweeper.max_jobs" in refused.err
