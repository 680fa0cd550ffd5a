"""Which jobs a sweep has, and their directories; those made from one another are those that Hydra composes."""

import time
from collections.abc import Iterator
from itertools import product
from typing import Any

import pytest
from calls import PinnRun
from hydra import initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import OmegaConf

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.sweep.composing import (
    LONGEST_OF_JOB,
    Composer,
    combinations,
    job_name,
    own_numbers,
    representatives,
    sweep_name,
    swept_settings,
)


@pytest.fixture
def loader() -> Iterator[Any]:
    """Hydra's."""
    with initialize_config_module("conf", version_base="1.3"):
        yield GlobalHydra.instance().config_loader()


def of_sweep(loader: Any, *overrides: str) -> Any:
    config = loader.load_configuration("config", [*overrides], run_mode=RunMode.MULTIRUN)
    config.hydra.sweep.dir = "a"
    return config


JOBS = (
    ["seed=0", "noise.snr_db=50"],
    ["seed=1", "noise.snr_db=20.5"],
    ["noise.snr_db=-1e1", "seed=2", "scheme=bayesian"],
    ["system.k=3", "system=van_der_pol", "system.ndof=3"],
    ["experiment=paper_training", "seed=4", "+training.extra=5"],
    ["seed=1", "seed=2", "system.ndof=2", "system.ndof=3"],
    ["seed=null", "system={ndof: 3}", "system.ndof=4"],
    ["hydra.sweep.subdir=5", "seed=3"],
    ["seed='3'", "threads=2"],
)


OF_SWEEP = ["hydra/launcher=basic", "hydra.job.config.override_dirname.exclude_keys=[seed]"]


@pytest.mark.parametrize("overrides", [pytest.param([], marks=pytest.mark.slow), OF_SWEEP])
def test_jobs_are_as_hydra_composes_them(loader: Any, overrides: list[str]) -> None:
    sweep = of_sweep(loader, *overrides)
    composer = Composer(loader, sweep)
    for job in (*JOBS, *JOBS[:3]):
        theirs, ours = loader.load_sweep_config(sweep, list(job)), composer.job(job)
        assert OmegaConf.to_yaml(ours) == OmegaConf.to_yaml(theirs)
        assert type(ours.seed) is type(theirs.seed)
        assert OmegaConf.is_struct(ours) == OmegaConf.is_struct(theirs)
        ours.noise.snr_db = 1.0  # a copy belongs to its job alone
        ours.hydra.overrides.task.append("a=1")


SCHEMES = ("scheme=sparse_recovery", "scheme=bayesian")


def test_only_what_is_not_a_number_is_composed_again(loader: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    composed = []
    load = loader.load_sweep_config
    monkeypatch.setattr(loader, "load_sweep_config", lambda *given: composed.append(given[1]) or load(*given))
    jobs = [[f"seed={seed}", f"noise.snr_db={db}", scheme] for seed in (0, 1) for db in (50, 20) for scheme in SCHEMES]
    composer = Composer(loader, of_sweep(loader))
    for job in jobs:
        composer.job(job)
    assert composed == [[scheme] for scheme in SCHEMES]


WRONG = (["sed=1"], ["system.ndof=1", "nois.snr_db=3"], ["system.nodf=3"], ["seed.a=3"], ["network=5"])


@pytest.mark.parametrize("job", WRONG)
def test_errors_are_hydras(loader: Any, job: list[str]) -> None:
    said, sweep = [], of_sweep(loader)
    for compose in (lambda: loader.load_sweep_config(sweep, list(job)), lambda: Composer(loader, sweep).job(job)):
        with pytest.raises((HydraException, ValueError)) as raised:
            compose()
        said.append(str(raised.value))
    assert said[0] == said[1]


def test_own_numbers() -> None:
    assert own_numbers(["a=1", "b=x", "c=-2.5e3", "+d=1", "hydra.x=1", "e=[1]", "f=1", "f=2"]) == ["a=1", "c=-2.5e3"]
    assert own_numbers(["a.b=1", "a={b: 2}", "ab=3", "a.c=4", "a.c.d=5"]) == ["ab=3"]
    assert own_numbers([]) == []


def test_numbers_of_a_setting_are_alike_and_every_word_is_composed_once() -> None:
    batch = [
        list(job) for job in product([f"seed={n}" for n in range(64)], ["a=1.5e3", "a=-2"], ["system=x", "system=y"])
    ]
    chosen = representatives(batch)
    assert len(chosen) == 2
    assert {override for job in chosen for override in job if override.startswith("system")} == {"system=x", "system=y"}
    assert {override.partition("=")[0] for job in chosen for override in job} == {"seed", "a", "system"}
    batch = [[f"scheme={scheme}", f"k=[{k}]"] for scheme, k in product("abc", range(4))]
    chosen = representatives(batch)
    assert {override for job in chosen for override in job} == {override for job in batch for override in job}
    assert len(chosen) < len(batch)


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
    pinn_run("--multirun", *overrides).refused("hydra.sweeper.max_jobs")
    assert time.process_time() - begun < 5.0


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


def test_a_sweep_is_named_by_its_settings_and_told_apart_by_all() -> None:
    names = {job_name(["seed=3", f"system.ndof={ndof}"], ["seed"]) for ndof in (2, 3, 2)}
    assert len(names) == 2
    assert all(name.startswith("seed=3_") for name in names)
    name = sweep_name(["system.ndof=3", "noise.snr_db=50,20", "seed=range(3)"], {})
    assert name.startswith("snr_db-seed_")
    assert name == sweep_name(["seed=range(3)", "system.ndof=3", "noise.snr_db=50,20", "threads=2"], {})
    assert name != sweep_name(["seed=range(3)", "system.ndof=4", "noise.snr_db=50,20"], {})
    assert sweep_name([], {"seed": "range(1, 3)"}).startswith("seed_")
    overrides = ["a=1,2", "b=[1,2]", "+c=range(2)", "d=choice(x)", "e=5", "f=interval(0,1)"]
    assert swept_settings(overrides, ["g"]) == ["a", "c", "d", "f", "g"]


@pytest.mark.parametrize("value", ["[10,10,8]", "a/b", "a b", "'..'", "\N{GREEK SMALL LETTER KAPPA}", "1" * 300])
def test_a_name_is_a_file_name_and_unmistakable(value: str) -> None:
    one, other = (job_name([f"case={value}{more}"], ["case"]) for more in ("", "_"))
    assert one != other
    for name in (one, other):
        assert len(name.encode()) <= LONGEST_OF_JOB
        assert not set(name) & set("/ '[]*?\"\\")
