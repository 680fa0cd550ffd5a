"""The variants behind one interface: which likelihood they take, what they hand over, which settings they refuse."""

from types import SimpleNamespace

import numpy as np
import pytest
from toy_likelihoods import GaussianLikelihood, correlated

from pinn_cli.posterior.conditional import Conditional
from pinn_cli.posterior.laplace import Laplace
from pinn_cli.posterior.marginal import Marginal
from pinn_cli.posterior.nuts import STATISTICS
from pinn_cli.system.priors import Gamma, HalfNormal
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


def test_shapes_of_what_is_sampled():
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


def test_draws_from_the_prior_are_in_the_likelihoods_order():
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
