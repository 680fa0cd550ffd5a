"""Which jobs stand for all of them when a sweep is checked."""

from __future__ import annotations

from itertools import product

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
