"""A killed run loses at most the chain that it was sampling, and goes on as if it had never stopped."""

import logging
import os
import shutil

import numpy as np
import pytest
from toy_likelihoods import GaussianLikelihood, correlated

from pinn_cli.posterior import nuts
from pinn_cli.posterior.marginal import Marginal
from pinn_cli.posterior.nuts import sample_chain
from pinn_cli.system.priors import Gamma
from pinn_cli.training.estimate import RunContext

LIKELIHOOD = GaussianLikelihood([1.0, 15.0], correlated([0.1, 0.3], 0.5))
PRIORS = (Gamma(2.0, 1.0), Gamma(2.0, 0.1))
SETTINGS = {"warmup": 20, "draws": 15, "target_accept": 0.8}


def run(directory, likelihood=LIKELIHOOD, priors=PRIORS, count=4, settings=SETTINGS, seed=0):
    posterior = Marginal(count, **settings)
    return posterior.sample(likelihood, priors, RunContext(seed=seed, directory=directory))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The directory of a run whose four chains are there, and its samples."""
    directory = tmp_path_factory.mktemp("finished")
    return directory, run(directory)


@pytest.fixture
def undisturbed(finished):
    return finished[1]


@pytest.fixture
def sampled(monkeypatch) -> list[int]:
    """The numbers of the chains that are sampled."""
    numbers = []

    def noting(density, seed, chain, *rest):
        numbers.append(chain)
        return sample_chain(density, seed, chain, *rest)

    monkeypatch.setattr(nuts, "sample_chain", noting)
    return numbers


def assert_same(samples, expected) -> None:
    np.testing.assert_array_equal(samples.draws, expected.draws)
    np.testing.assert_array_equal(samples.sigma_force, expected.sigma_force)
    for name, values in expected.statistics.items():
        np.testing.assert_array_equal(samples.statistics[name], values)
        assert samples.statistics[name].dtype == values.dtype


def test_a_killed_run_goes_on_after_its_last_finished_chain(tmp_path, monkeypatch, undisturbed):
    def killed_in_the_third(density, seed, chain, settings, after_iteration):
        if chain == 3:
            raise KeyboardInterrupt
        return sample_chain(density, seed, chain, settings, after_iteration)

    monkeypatch.setattr(nuts, "sample_chain", killed_in_the_third)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path)
    assert sorted(os.listdir(tmp_path / "chains")) == ["chain_1.npz", "chain_2.npz"]

    again = []
    monkeypatch.setattr(nuts, "sample_chain", lambda *a: again.append(a[2]) or sample_chain(*a))
    assert_same(run(tmp_path), undisturbed)
    assert again == [3, 4]


def test_a_finished_run_samples_nothing_and_more_chains_only_those(tmp_path, sampled, finished, caplog):
    directory, undisturbed = finished
    shutil.copytree(directory, tmp_path, dirs_exist_ok=True)
    (tmp_path / "chains" / "chain_4.npz").unlink()
    with caplog.at_level(logging.INFO, "pinn_cli"):
        assert_same(run(tmp_path), undisturbed)
    assert sampled == [4]
    assert "3 of 4 chains were finished before" in caplog.text


def truncate(place) -> None:
    place.write_bytes(place.read_bytes()[:300])


def empty(place) -> None:
    place.write_bytes(b"")


def swap(place) -> None:
    shutil.copy(place.with_name("chain_1.npz"), place)


@pytest.mark.parametrize("harm", [truncate, empty, swap])
def test_a_file_that_is_not_what_it_should_be_is_sampled_again(harm, tmp_path, sampled, finished, caplog):
    directory, undisturbed = finished
    shutil.copytree(directory, tmp_path, dirs_exist_ok=True)
    harm(tmp_path / "chains" / "chain_2.npz")
    with caplog.at_level(logging.WARNING, "pinn_cli"):
        assert_same(run(tmp_path), undisturbed)
    assert sampled == [2]
    (message,) = (record.getMessage() for record in caplog.records)
    assert "chain 2 is sampled again" in message
    assert "\n" not in message
    sampled.clear()
    run(tmp_path)
    assert sampled == []


@pytest.mark.parametrize(
    "other",
    [
        {"seed": 1},
        {"settings": SETTINGS | {"warmup": 21}},
        {"priors": (Gamma(2.0, 1.0), Gamma(2.0, 0.1000001))},
        {"likelihood": GaussianLikelihood([1.0, 15.0 + 1e-12], correlated([0.1, 0.3], 0.5))},
        {"likelihood": GaussianLikelihood([1.0, 15.0], correlated([0.1, 0.3], 0.5), ("c_1", "c_2"))},
        {"likelihood": GaussianLikelihood([1.0, 15.0], correlated([0.1, 0.3], 0.5), s_std=0.021)},
    ],
    ids=["seed", "warmup", "prior", "peak", "names", "noise"],
)
def test_chains_of_another_posterior_are_not_taken_over(other, tmp_path, sampled, finished):
    shutil.copytree(finished[0], tmp_path, dirs_exist_ok=True)
    run(tmp_path, count=1, **other)
    assert sampled == [1]


def test_a_run_without_a_directory_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(None, count=1)
    assert not list(tmp_path.iterdir())
