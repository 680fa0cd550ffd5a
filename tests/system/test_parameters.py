"""What a parameter knows of itself, its name, all of them as a vector, and their priors."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from calls import refusal
from matplotlib.mathtext import MathTextParser
from scipy import stats
from small_problems import small_chain
from structures import braced, shuffled
from toy_likelihoods import slopes

from pinn_cli.scheme.bayesian import KINDS, read_priors
from pinn_cli.system.parameters import Labels, Parameter, ParameterVector, upright
from pinn_cli.system.priors import Gamma, HalfNormal, LogNormal, Normal, stacked

DOFS = ("ground_floor", "mezzanine", "roof")
CONNECTIONS = ("storey_1", "storey_2", "storey_3", "brace", "tie", "damper")


@pytest.mark.parametrize("prescribed", [0.1, 0.3, 7.3, 123.4])
@pytest.mark.parametrize("prior_std", [0.7, 1e3])
def test_a_value_is_never_below_its_bound(prescribed, prior_std):
    free, bounded = (Parameter("k", 1, prescribed, prior_std, positive=positive) for positive in (False, True))
    assert (free.lower, bounded.lower) == (-math.inf, -prescribed)
    assert bounded.value(bounded.lower) == 0.0
    assert bounded.value(prior_std * (bounded.lower / prior_std) * (1 + 1e-15)) >= 0.0
    assert bounded.value(-0.5 * prescribed) == 0.5 * prescribed
    assert free.value(-2.0 * prescribed) == -prescribed


def test_a_parameter_is_the_same_whatever_is_believed_of_it():
    believed, bare = Parameter("kappa", 3, 100.0, 7.5, unit="N/m^3"), Parameter("kappa", 3)
    assert believed == bare
    assert {believed: 1}[bare] == 1
    assert believed != Parameter("kappa", 2)
    assert (bare.name, bare.owner, bare.symbol) == ("kappa_4", "connection 4", r"$\kappa_{4}$")
    assert (Parameter("m", 0).owner, Parameter("k", 0, label="brace").name) == ("DOF 1", "k_brace")


@pytest.mark.parametrize("name", ["$", "a$b", "$\\frac$", "#^", "{", "a\\", '"`', "%&_", "\x1b[2J", "a{b}c~'"])
def test_any_name_can_be_set_as_mathematics(name):
    parser = MathTextParser("path")
    parser.parse(Parameter("gain", 0, label=name).symbol)
    assert parser.parse(rf"${upright(f'{name}m')}$").width > parser.parse(rf"${upright('m')}$").width


def test_parameters_go_by_the_names_of_their_masses_and_connections():
    structure = replace(braced(), labels=Labels(DOFS, CONNECTIONS))
    names = [parameter.name for parameter in structure.every_parameter()]
    assert names[:3] == ["m_ground_floor", "m_mezzanine", "m_roof"]
    # A kind that few connections have is named after those, not after the first ones of the structure.
    assert (names[-1], structure.parameter("kappa", 2).name) == ("mu_damper", "kappa_storey_3")
    assert (structure.parameter("k", 3).owner, structure.parameter("m", 2).owner) == ("connection brace", "DOF roof")
    assert [structure.dof_name(i) for i in range(3)] == list(DOFS)
    # Names outlive a change of values and of laws; without names parameters are numbered from one.
    assert structure.with_values({structure.parameter("k", 3): 7.0}).parameter("k", 3).name == "k_brace"
    assert structure.linearised().parameter("k", 5).name == "k_damper"
    assert (shuffled().parameter("k", 1).name, shuffled().dof_name(0)) == ("k_2", "1")


@pytest.mark.parametrize("as_is", [torch.as_tensor, np.asarray], ids=["tensors", "arrays"])
def test_a_vector_of_parameters_by_name(as_is):
    structure = braced()
    moving = [Parameter("mu", 0), Parameter("k", 4), Parameter("m", 1)]
    nominal = {kind: as_is(values.numpy()) for kind, values in structure.parameters.items()}
    vector = ParameterVector(nominal, moving)
    assert (vector.kinds, vector.places) == (("m", "k", "mu"), 3 + 6 + 1)
    values = vector.values(as_is(np.array([0.1, 2.0, -1.0])))
    expected = {kind: given.numpy().copy() for kind, given in structure.parameters.items()}
    expected["mu"][0] += 0.1
    expected["k"][4] += 2.0
    expected["m"][1] -= 1.0
    for kind, given in expected.items():
        np.testing.assert_array_equal(values[kind], given)


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
