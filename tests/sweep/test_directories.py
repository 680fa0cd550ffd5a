"""Directories that the same overrides find again."""

import pytest

from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.sweep.composing import LONGEST_OF_JOB, job_name, sweep_name, swept_settings


@pytest.mark.parametrize(
    ("overrides", "name"),
    [
        (["seed=3"], "seed=3"),
        (["seed=3", "noise.snr_db=50"], "noise.snr_db=50,seed=3"),
        (["noise.snr_db=50", "seed=3", "threads=2", "resume=auto", "device=cpu"], "noise.snr_db=50,seed=3"),
        (["+a=1"], "+a=1"),
        ([], "job"),
    ],
)
def test_a_job_is_named_by_what_tells_it_apart(overrides: list[str], name: str) -> None:
    assert job_name(overrides, [*map(setting_of, overrides)]) == name
    assert job_name(overrides[::-1], [*map(setting_of, overrides)]) == name


def test_what_all_jobs_share_is_a_digest() -> None:
    names = {job_name(["seed=3", f"system.ndof={ndof}"], ["seed"]) for ndof in (2, 3, 2)}
    assert len(names) == 2
    assert all(name.startswith("seed=3_") for name in names)


@pytest.mark.parametrize("value", ["[10,10,8]", "a/b", "a b", "'..'", "\N{GREEK SMALL LETTER KAPPA}", "1" * 300])
def test_a_name_is_a_file_name_and_unmistakable(value: str) -> None:
    one, other = (job_name([f"case={value}{more}"], ["case"]) for more in ("", "_"))
    assert one != other
    for name in (one, other):
        assert len(name.encode()) <= LONGEST_OF_JOB
        assert not set(name) & set("/ '[]*?\"\\")


def test_a_sweep_is_named_by_its_settings_and_told_apart_by_all() -> None:
    name = sweep_name(["system.ndof=3", "noise.snr_db=50,20", "seed=range(3)"], {})
    assert name.startswith("snr_db-seed_")
    assert name == sweep_name(["seed=range(3)", "system.ndof=3", "noise.snr_db=50,20", "threads=2"], {})
    assert name != sweep_name(["seed=range(3)", "system.ndof=4", "noise.snr_db=50,20"], {})
    assert sweep_name([], {"seed": "range(1, 3)"}).startswith("seed_")


def test_what_is_swept() -> None:
    overrides = ["a=1,2", "b=[1,2]", "+c=range(2)", "d=choice(x)", "e=5", "f=interval(0,1)"]
    assert swept_settings(overrides, ["g"]) == ["a", "c", "d", "f", "g"]
