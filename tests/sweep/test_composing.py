"""Jobs that are made from one another are those that Hydra composes."""

from __future__ import annotations

from typing import Any

import pytest
from hydra import initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import OmegaConf

from pinn_cli.sweep import composing
from pinn_cli.sweep.composing import compose_job, own_numbers


@pytest.fixture
def loader(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Hydra's, new; nothing is composed yet."""
    monkeypatch.setattr(composing, "_composed", {})
    with initialize_config_module("conf", version_base="1.3"):
        yield GlobalHydra.instance().config_loader()


def _both(loader: Any, sweep: list[str], *jobs: list[str]) -> list[tuple[Any, Any]]:
    """By Hydra and by us."""
    master = loader.load_configuration("config", sweep, run_mode=RunMode.MULTIRUN)
    master.hydra.sweep.dir = "a"
    return [(loader.load_sweep_config(master, list(job)), compose_job(loader, master, job)) for job in jobs]


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


@pytest.mark.parametrize("sweep", [[], OF_SWEEP])
def test_jobs_are_as_hydra_composes_them(loader: Any, sweep: list[str]) -> None:
    for theirs, ours in _both(loader, sweep, *JOBS, *JOBS):
        assert OmegaConf.to_yaml(ours) == OmegaConf.to_yaml(theirs)
        assert type(ours.seed) is type(theirs.seed)
        assert OmegaConf.is_struct(ours) == OmegaConf.is_struct(theirs)


SCHEMES = ("scheme=sparse_recovery", "scheme=bayesian")


def test_only_what_is_not_a_number_is_composed_again(loader: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    composed = []
    load = loader.load_sweep_config
    monkeypatch.setattr(loader, "load_sweep_config", lambda *given: composed.append(given[1]) or load(*given))
    jobs = [[f"seed={seed}", f"noise.snr_db={db}", scheme] for seed in (0, 1) for db in (50, 20) for scheme in SCHEMES]
    master = loader.load_configuration("config", [], run_mode=RunMode.MULTIRUN)
    for job in jobs:
        compose_job(loader, master, job)
    assert composed == [[scheme] for scheme in SCHEMES]


def test_a_copy_belongs_to_its_job_alone(loader: Any) -> None:
    (_, first), (_, second) = _both(loader, [], ["seed=0"], ["seed=0"])
    first.noise.snr_db = 1.0
    first.hydra.overrides.task.append("a=1")
    assert second.noise.snr_db == 50
    assert list(second.hydra.overrides.task) == ["seed=0"]


WRONG = (["sed=1"], ["system.ndof=1", "nois.snr_db=3"], ["system.nodf=3"], ["seed.a=3"], ["network=5"])


@pytest.mark.parametrize("job", WRONG)
def test_errors_are_hydras(loader: Any, job: list[str]) -> None:
    said = []
    master = loader.load_configuration("config", [], run_mode=RunMode.MULTIRUN)
    for compose in (lambda: loader.load_sweep_config(master, list(job)), lambda: compose_job(loader, master, job)):
        with pytest.raises((HydraException, ValueError)) as raised:
            compose()
        said.append(str(raised.value))
    assert said[0] == said[1]


def test_own_numbers() -> None:
    assert own_numbers(["a=1", "b=x", "c=-2.5e3", "+d=1", "hydra.x=1", "e=[1]", "f=1", "f=2"]) == ["a=1", "c=-2.5e3"]
    assert own_numbers(["a.b=1", "a={b: 2}", "ab=3", "a.c=4", "a.c.d=5"]) == ["ab=3"]
    assert own_numbers([]) == []
