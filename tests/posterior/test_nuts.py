"""NUTS against posteriors that are known in closed form or by quadrature."""

import arviz
import numpy as np
import pytest
import torch
from scipy import integrate, stats
from toy_likelihoods import GaussianLikelihood, RegressionLikelihood, correlated

from pinn_cli.posterior.nuts import STATISTICS, NutsSettings, sample_chain
from pinn_cli.posterior.target import Target
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.priors import Gamma, HalfNormal, LogNormal, Normal

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
