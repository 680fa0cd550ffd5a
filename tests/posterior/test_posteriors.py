"""NUTS and the posteriors that it samples: closed forms, quadrature, what they hand over, and chains that are kept."""

import contextlib
import logging
import os
import shutil
from types import SimpleNamespace

import arviz
import numpy as np
import pytest
import torch
from scipy import integrate, stats
from toy_likelihoods import GaussianLikelihood, RegressionLikelihood, correlated

from pinn_cli.posterior import nuts
from pinn_cli.posterior.conditional import Conditional
from pinn_cli.posterior.laplace import Laplace
from pinn_cli.posterior.marginal import Marginal
from pinn_cli.posterior.nuts import STATISTICS, NutsSettings, sample_chain
from pinn_cli.posterior.target import Target
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.priors import Gamma, HalfNormal, LogNormal, Normal
from pinn_cli.training.estimate import RunContext

NAMES = ("c_2", "k_1")
SIGMA = (0.1, np.nan, 0.3)
WIDE = GaussianLikelihood([1.0, 15.0], correlated([0.1, 0.3], 0.5), NAMES, SIGMA)
NARROW = GaussianLikelihood([1.2, 15.5], correlated([0.02, 0.06], 0.5), NAMES, SIGMA)
BOTH = SimpleNamespace(marginal=WIDE, conditional=NARROW)
PRIORS = (HalfNormal(5.0), Gamma(2.0, 0.1))


@pytest.mark.parametrize(
    ("posterior", "likelihood"),
    [(Marginal(1, 100, 300), WIDE), (Conditional(1, 100, 300), NARROW), (Laplace(4000), WIDE)],
    ids=["marginal", "conditional", "laplace"],
)
def test_each_samples_its_own_likelihood(posterior, likelihood):
    samples = posterior.sample(posterior.likelihood(BOTH), PRIORS, RunContext(seed=1))
    std = np.sqrt(np.diag(likelihood.covariance))
    np.testing.assert_allclose(samples.draws.mean((0, 1)), likelihood.peak, atol=0.2 * std.max())
    np.testing.assert_allclose(samples.draws.std((0, 1)), std, rtol=0.15)
    assert (samples.method, samples.names) == (posterior.name, NAMES)


def test_shapes_of_what_is_sampled_and_the_order_of_the_prior():
    samples = Marginal(chains=3, warmup=20, draws=10).sample(WIDE, PRIORS, RunContext())
    assert samples.draws.shape == (3, 10, 2)
    assert samples.sigma_force.shape == (3, 10, 2)
    np.testing.assert_array_equal(samples.force_dofs, [1, 3])
    np.testing.assert_allclose(samples.sigma_force[..., 1] / samples.sigma_force[..., 0], 3.0)
    assert samples.prior.shape == (10, 2)
    assert {name: values.shape for name, values in samples.statistics.items()} == dict.fromkeys(STATISTICS, (3, 10))
    assert (samples.warmup, samples.seconds.shape) == (20, (3,))
    samples = Laplace(50).sample(WIDE, PRIORS, RunContext())
    assert (samples.draws.shape, samples.sigma_force.shape, samples.prior.shape) == ((1, 50, 2), (1, 50, 2), (50, 2))
    assert (samples.statistics, samples.warmup, samples.seconds.shape) == ({}, 0, (1,))
    prior = Laplace(4000).sample(WIDE, PRIORS, RunContext()).prior
    np.testing.assert_allclose(prior.mean(0), [HalfNormal(5.0).mean, 20.0], rtol=0.1)
    np.testing.assert_allclose(prior.std(0), [HalfNormal(5.0).std, Gamma(2.0, 0.1).std], rtol=0.1)


@pytest.mark.parametrize("posterior", [Marginal(2, 20, 10), Laplace(10)], ids=["marginal", "laplace"])
def test_the_seed_decides_and_nothing_else(posterior):
    first, again, other = (posterior.sample(WIDE, PRIORS, RunContext(seed=seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.draws, again.draws)
    np.testing.assert_array_equal(first.prior, again.prior)
    assert not np.any(first.draws == other.draws)
    assert not np.any(first.prior == other.prior)


@pytest.mark.slow
def test_thirty_parameters():
    peak = np.linspace(1.0, 100.0, 30)
    likelihood = GaussianLikelihood(peak, correlated(0.1 * peak, 0.9))
    priors = [HalfNormal(1000.0)] * 30
    samples = Marginal(2, 100, 100).sample(likelihood, priors, RunContext())
    np.testing.assert_allclose(samples.draws.mean((0, 1)), peak, atol=0.04 * peak.max())
    assert not samples.statistics["diverging"].any()


SETTINGS = NutsSettings(warmup=100, draws=400, target_accept=0.8)
FLAT = Normal(0.0, 1e6)


def sampled(likelihood, priors, settings: NutsSettings = SETTINGS, chains: int = 1) -> np.ndarray:
    """Theta and s, (chains, draws, p + 1)."""
    target = Target(likelihood, priors)
    x = np.stack([target.whitening.coordinates(sample_chain(target, 0, chain, settings).q) for chain in range(chains)])
    return np.concatenate([target.parameters(x), x[..., -1:]], axis=-1)


def assert_moments(draws: np.ndarray, mean: np.ndarray, std: np.ndarray) -> None:
    """Within four Monte Carlo standard errors."""
    for i, (m, s) in enumerate(zip(mean, std, strict=True)):
        assert abs(draws[..., i].mean() - m) < 4 * arviz.mcse(draws[..., i]), i
        assert abs(draws[..., i].std() - s) < 4 * arviz.mcse(draws[..., i], method="sd"), i


def test_a_gaussian_under_flat_priors():
    std, correlation = np.array([0.1, 2.0, 30.0]), 0.99
    likelihood = GaussianLikelihood([1.0, -15.0, 100.0], correlated(std, correlation))
    draws = sampled(likelihood, [FLAT] * 3)
    assert_moments(draws, np.append(likelihood.peak, 0.0), np.append(std, likelihood.s_std))
    found, atol = np.corrcoef(draws.reshape(-1, 4).T), 0.12 * (1 - correlation**2) + 1e-3
    np.testing.assert_allclose(found[:3, :3], correlated(np.ones(3), correlation), atol=atol)


@pytest.mark.slow
def test_unknown_noise_makes_students_t():
    """p(theta) with s integrated out under its flat prior: t with N degrees of freedom."""
    likelihood = RegressionLikelihood([3.0], [[0.04]])
    likelihood.count, likelihood.s_std = 20, 0.16
    draws = sampled(likelihood, [FLAT], NutsSettings(100, 800, 0.8))[..., 0]
    known = stats.t(20, loc=3.0, scale=0.2)
    assert abs(draws.std() - known.std()) < 4 * arviz.mcse(draws, method="sd")
    # Successive draws of NUTS are about independent here, every fifth one surely.
    assert stats.kstest(draws[:, ::5].ravel(), known.cdf).pvalue > 0.001


@pytest.mark.parametrize(
    ("prior", "peak"),
    [
        pytest.param(Gamma(2.0, 1.0), 0.3, marks=pytest.mark.slow),
        (HalfNormal(1.0), -0.5),
        pytest.param(LogNormal(1.0, 1.0), 0.3, marks=pytest.mark.slow),
    ],
    ids=lambda x: getattr(x, "name", x),
)
def test_positive_parameters_against_quadrature(prior, peak):
    likelihood = GaussianLikelihood([peak], [[0.25]])
    draws = sampled(likelihood, [prior])[..., :1]
    assert np.all(draws > 0)

    def moment(power: int) -> float:
        def density(theta):
            return theta**power * np.exp(prior.log_density(theta) - 2 * (theta - peak) ** 2)

        return integrate.quad(density, 0, 10, epsabs=0, points=[max(peak, 0.1)])[0]

    mean = moment(1) / moment(0)
    assert_moments(draws, np.array([mean]), np.array([np.sqrt(moment(2) / moment(0) - mean**2)]))


@pytest.mark.slow
def test_a_parameter_at_zero_does_not_hold_its_neighbour_up():
    """A truncated Gaussian of correlation 0.95, against independent draws of it: chains used to stick in its tail."""
    likelihood = GaussianLikelihood([0.7, 15.0], correlated([1.0, 1.0], 0.95))
    priors = [HalfNormal(100.0), Normal(0.0, 1000.0)]
    draws = sampled(likelihood, priors, NutsSettings(150, 400, 0.8), chains=2)[..., :2]
    known = np.random.default_rng(0).multivariate_normal(likelihood.peak, likelihood.covariance, 400_000)
    known = known[known[:, 0] > 0]
    assert_moments(draws, known.mean(0), known.std(0))
    assert arviz.rhat(draws[..., 0]) < 1.02


@pytest.fixture(scope="module")
def target() -> Target:
    return Target(GaussianLikelihood([1.0, 15.0], correlated([0.3, 2.0], 0.9)), [Gamma(2.0, 1.0), Gamma(2.0, 0.1)])


SHORT = NutsSettings(warmup=30, draws=40, target_accept=0.8)


def test_a_chain_can_be_repeated_bit_for_bit_and_leaves_torchs_generator_alone(target):
    first = sample_chain(target, 3, 1, SHORT)
    torch.manual_seed(99)
    state = torch.get_rng_state()
    other, second = sample_chain(target, 3, 2, SHORT), sample_chain(target, 3, 1, SHORT)
    assert torch.equal(torch.get_rng_state(), state)
    np.testing.assert_array_equal(first.q, second.q)
    for name in STATISTICS:
        np.testing.assert_array_equal(first.statistics[name], second.statistics[name])
    assert not np.any(first.q[0] == other.q[0])
    assert not np.any(first.q[0] == sample_chain(target, 4, 1, SHORT).q[0])


def test_what_is_noted_about_every_draw(target):
    calls = []
    chain = sample_chain(target, 0, 1, SHORT, lambda: calls.append(None))
    noted = chain.statistics
    assert len(calls) == SHORT.warmup + SHORT.draws
    assert {name: values.shape for name, values in noted.items()} == dict.fromkeys(STATISTICS, (SHORT.draws,))
    np.testing.assert_allclose(noted["lp"], [-target.potential(q)[0] for q in chain.q])
    assert np.all((2 ** (noted["tree_depth"] - 1) <= noted["n_steps"]) & (noted["n_steps"] < 2 ** noted["tree_depth"]))
    assert len(set(noted["step_size"])) == 1
    assert not noted["diverging"].any()
    assert noted["diverging"].dtype == bool


def test_divergences_are_noted():
    """Neal's funnel, sampled with long steps."""

    class Funnel:
        size = 5

        def potential(self, q):
            v, rest = q[0], q[1:]
            value = v**2 / 18 + 0.5 * np.exp(-v) * float(rest @ rest) + 2 * v
            slope = np.append(v / 9 - 0.5 * np.exp(-v) * float(rest @ rest) + 2, np.exp(-v) * rest)
            return value, slope

    chain = sample_chain(Funnel(), 0, 1, NutsSettings(100, 400, 0.4))
    assert chain.statistics["diverging"].any()


def test_a_density_that_is_nowhere_finite_is_told():
    class Nowhere:
        size = 2

        def potential(self, q):
            return np.inf, np.zeros(2)

    with pytest.raises(DivergenceError, match="no chain can start"):
        sample_chain(Nowhere(), 0, 1, SHORT)


LIKELIHOOD = GaussianLikelihood([1.0, 15.0], correlated([0.1, 0.3], 0.5))
POSITIVE = (Gamma(2.0, 1.0), Gamma(2.0, 0.1))
FEW = {"warmup": 20, "draws": 15, "target_accept": 0.8}


def run(directory, likelihood=LIKELIHOOD, priors=POSITIVE, count=4, settings=FEW, seed=0):
    posterior = Marginal(count, **settings)
    return posterior.sample(likelihood, priors, RunContext(seed=seed, directory=directory))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The directory of a run whose four chains are there, and its samples; without one nothing is written."""
    directory = tmp_path_factory.mktemp("finished")
    with contextlib.chdir(directory):
        undisturbed = run(None)
    assert not list(directory.iterdir())
    assert_same(run(directory), undisturbed)
    return directory, undisturbed


@pytest.fixture
def numbers(monkeypatch) -> list[int]:
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


def test_a_killed_run_goes_on_after_its_last_finished_chain(tmp_path, monkeypatch, finished):
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
    assert_same(run(tmp_path), finished[1])
    assert again == [3, 4]


def test_a_finished_run_samples_nothing_and_more_chains_only_those(tmp_path, numbers, finished, caplog):
    directory, undisturbed = finished
    shutil.copytree(directory, tmp_path, dirs_exist_ok=True)
    (tmp_path / "chains" / "chain_4.npz").unlink()
    with caplog.at_level(logging.INFO, "pinn_cli"):
        assert_same(run(tmp_path), undisturbed)
    assert numbers == [4]
    assert "3 of 4 chains were finished before" in caplog.text


HARM = {
    "cut short": lambda place: place.write_bytes(place.read_bytes()[:300]),
    "empty": lambda place: place.write_bytes(b""),
    "of another chain": lambda place: shutil.copy(place.with_name("chain_1.npz"), place),
}


@pytest.mark.parametrize("harm", HARM.values(), ids=HARM)
def test_a_file_that_is_not_what_it_should_be_is_sampled_again(harm, tmp_path, numbers, finished, caplog):
    directory, undisturbed = finished
    shutil.copytree(directory, tmp_path, dirs_exist_ok=True)
    harm(tmp_path / "chains" / "chain_2.npz")
    with caplog.at_level(logging.WARNING, "pinn_cli"):
        assert_same(run(tmp_path), undisturbed)
    assert numbers == [2]
    (message,) = (record.getMessage() for record in caplog.records)
    assert "chain 2 is sampled again" in message
    assert "\n" not in message
    numbers.clear()
    run(tmp_path)
    assert numbers == []


@pytest.mark.parametrize(
    "other",
    [
        {"seed": 1},
        {"settings": FEW | {"warmup": 21}},
        {"priors": (Gamma(2.0, 1.0), Gamma(2.0, 0.1000001))},
        {"likelihood": GaussianLikelihood([1.0, 15.0 + 1e-12], correlated([0.1, 0.3], 0.5))},
        {"likelihood": GaussianLikelihood([1.0, 15.0], correlated([0.1, 0.3], 0.5), ("c_1", "c_2"))},
        {"likelihood": GaussianLikelihood([1.0, 15.0], correlated([0.1, 0.3], 0.5), s_std=0.021)},
    ],
    ids=["seed", "warmup", "prior", "peak", "names", "noise"],
)
def test_chains_of_another_posterior_are_not_taken_over(other, tmp_path, numbers, finished):
    shutil.copytree(finished[0], tmp_path, dirs_exist_ok=True)
    run(tmp_path, count=1, **other)
    assert numbers == [1]
