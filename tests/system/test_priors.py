"""Priors against scipy's distributions, and how a user writes them."""

import numpy as np
import pytest
from refusals import refusal
from scipy import stats
from small_problems import small_chain
from toy_likelihoods import slopes

from pinn_cli.scheme.bayesian import KINDS, read_priors
from pinn_cli.system.priors import Gamma, HalfNormal, LogNormal, Normal, stacked

PRIORS = [
    (Gamma(2.0, 0.1), stats.gamma(2.0, scale=10.0)),
    (Gamma(0.5, 3.0), stats.gamma(0.5, scale=1 / 3)),
    (HalfNormal(5.0), stats.halfnorm(scale=5.0)),
    (LogNormal(15.0, 0.3), stats.lognorm(0.3, scale=15.0)),
    (Normal(-1.0, 2.0), stats.norm(-1.0, 2.0)),
]
THETA = np.array([0.01, 0.7, 4.0, 25.0])


@pytest.mark.parametrize(("prior", "known"), PRIORS, ids=lambda x: getattr(x, "name", ""))
def test_density_slope_moments_and_draws_are_scipys(prior, known):
    np.testing.assert_allclose(prior.log_density(THETA), known.logpdf(THETA), rtol=1e-12)
    assert (prior.mean, prior.std) == pytest.approx((known.mean(), known.std()), rel=1e-12)
    assert prior.positive == (known.support()[0] == 0.0)
    numeric = slopes(lambda theta: prior.log_density(theta).sum(), THETA, 1e-6 * THETA)
    np.testing.assert_allclose(prior.slope(THETA), numeric, rtol=1e-6, atol=1e-6)
    draws = prior.sample(np.random.default_rng(0), 2000)
    assert stats.kstest(draws, known.cdf).pvalue > 0.001


def test_a_gamma_by_its_moments_and_a_log_normal_that_is_too_wide_to_have_any():
    gamma = Gamma.of_moments(15.0, 3.0)
    assert (gamma.mean, gamma.std) == pytest.approx((15.0, 3.0))
    with np.errstate(over="ignore"):
        assert LogNormal(1.0, 50.0).std == np.inf


def test_stacked_priors_are_those_that_they_were_made_of():
    priors = [prior for prior, _ in PRIORS]
    theta = np.linspace(0.5, 3.0, len(priors))
    together = np.full(len(priors), np.nan)
    for places, prior in stacked(priors):
        together[places] = prior.log_density(theta[places])
    alone = [float(prior.log_density(x)) for prior, x in zip(priors, theta, strict=True)]
    np.testing.assert_allclose(together, alone, rtol=1e-14)


def test_priors_by_kind_name_and_pattern():
    given = {
        "k": {"kind": "gamma", "mean": 15.0, "std": 3.0},
        "k_2": {"kind": "log_normal", "median": 14.0, "sigma": 0.2},
        "c_[1-2]": {"kind": "half_normal", "scale": 5},
        "kappa_3": {"kind": "normal", "mean": 0.0, "std": 100.0},
        "mu": {"kind": "half_normal", "scale": 1.0},
        "m": None,
    }
    priors = {(p.kind, p.index): prior for p, prior in read_priors(given, small_chain()).items()}
    assert priors[("k", 0)] == priors[("k", 2)] == Gamma.of_moments(15.0, 3.0)
    assert priors[("k", 1)] == LogNormal(14.0, 0.2)
    assert {place for place in priors if place[0] == "c"} == {("c", 0), ("c", 1)}
    assert priors[("kappa", 2)] == Normal(0.0, 100.0)
    assert {kind for kind, _ in priors} == {"k", "c", "kappa"}
    assert read_priors(None, small_chain()) == {}
    assert set(KINDS) == {prior.name for prior, _ in PRIORS}


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("gamma", "scheme.priors=gamma"),
        ({"k": 3.0}, "scheme.priors.k=3.0"),
        ({"k": {"shape": 2}}, "scheme.priors.k.kind=(missing)"),
        ({"k": {"kind": "gama"}}, "scheme.priors.k.kind=gama"),
        ({"k": {"kind": "gamma", "shape": 2}}, "scheme.priors.k=gamma with shape"),
        ({"k": {"kind": "gamma", "shape": 2, "std": 1}}, "scheme.priors.k=gamma with shape, std: must be"),
        ({"k": {"kind": "gamma", "shape": 2, "rate": 0}}, "scheme.priors.k.rate=0"),
        ({"k_1": {"kind": "half_normal"}}, "scheme.priors.k_1.scale=(missing)"),
        ({"k": {"kind": "half_normal", "scal": 5}}, "scheme.priors.k.scal=5"),
        ({"k": {"kind": "log_normal", "median": 1, "sigma": True}}, "scheme.priors.k.sigma=True"),
        ({"k": {"kind": "normal", "mean": float("nan"), "std": 1}}, "scheme.priors.k.mean=nan"),
        ({"k_9": {"kind": "half_normal", "scale": 5}}, "scheme.priors.k_9=k_9"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(given, told):
    assert refusal(read_priors, given, small_chain()).startswith(told)
