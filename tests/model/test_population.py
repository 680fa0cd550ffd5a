"""The hierarchical model of similar structures: exact where it can be, with bands that hold, whatever the units."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from pinn_cli.model.knowledge import ParameterKnowledge
from pinn_cli.model.population import Population

WIDE = 1e3  # of an unknown parameter about 100


def known(mean, covariance, prescribed=None, first_std=WIDE):
    mean, nothing = np.asarray(mean, float), np.zeros(len(mean))
    return ParameterKnowledge(
        mean, np.asarray(covariance, float), nothing, nothing, np.full(len(mean), float(first_std)), prescribed
    )


def drawn(seed, count, spread, std, size=3):
    """Structures of mean 100, correlated records of unlike quality, the first hardly measured; truth and knowledge."""
    generator = np.random.default_rng(seed)
    truth = 100.0 + spread * generator.standard_normal((count, size))
    runs = []
    for i, theta in enumerate(truth):
        stds = std * np.exp(0.5 * generator.standard_normal(size)) * (30.0 if i == 0 else 1.0)
        covariance = np.outer(stds, stds) * (-0.6) ** np.abs(np.subtract.outer(range(size), range(size)))
        runs.append(known(generator.multivariate_normal(theta, covariance), covariance))
    return truth, runs


def population(runs, lower=-np.inf):
    return Population(runs, np.full(len(runs[0].mean), lower))


def test_of_one_parameter_it_is_what_summing_over_mean_and_spread_gives():
    mean, std = np.array([96.0, 99.0, 104.0, 107.0, 90.0]), np.array([2.0, 1.0, 3.0, 1.5, 20.0])
    found = population([known([m], [[s**2]]) for m, s in zip(mean, std, strict=True)])
    mu, edges = np.linspace(60.0, 140.0, 1201), np.concatenate(([0.0], np.geomspace(1e-2, 3e3, 1501)))
    tau = 0.5 * (edges[1:] + edges[:-1])
    log = norm.logpdf(mean, mu[:, None, None], np.hypot(std, tau[:, None])).sum(-1)
    mass = np.exp(log - log.max()) * np.diff(edges) / (1.0 + (tau / WIDE) ** 2)
    mass /= mass.sum()
    for quantile, at in ((0.05, found.mean.lower), (0.5, found.mean.estimate), (0.95, found.mean.upper)):
        assert mass.sum(1)[mu <= at].sum() == pytest.approx(quantile, abs=0.01)
    assert mass.sum(0)[tau <= found.spread.estimate].sum() == pytest.approx(0.5, abs=0.01)
    inside = (tau >= found.spread.lower) & (tau <= found.spread.upper)
    assert mass.sum(0)[inside].sum() == pytest.approx(0.9, abs=0.015)
    gain = tau**2 / (tau**2 + std[:, None] ** 2)
    for i in range(len(mean)):
        center, spread = mu[:, None] + gain[i] * (mean[i] - mu[:, None]), std[i] * np.sqrt(gain[i])
        for quantile, at in ((0.05, found.structures.lower), (0.95, found.structures.upper)):
            assert (mass * norm.cdf(at[i, 0], center, spread)).sum() == pytest.approx(quantile, abs=0.01)


@pytest.mark.parametrize(("count", "spread", "std"), [(20, 5.0, 1.0), (20, 5.0, 5.0), (6, 5.0, 3.0)])
def test_intervals_hold(count, spread, std):
    held, outliers = [], 0
    for seed in range(40):
        truth, runs = drawn(seed, count, spread, std)
        found = population(runs)
        for part, true in ((found.structures, truth), (found.mean, 100.0), (found.spread, spread)):
            held.append(((part.lower <= true) & (true <= part.upper)).mean())
        outliers += found.outlier.any()
    share = np.array(held).reshape(-1, 3).mean(0)
    assert (share > 0.8).all(), share
    assert share[0] < 0.96
    assert outliers <= 2


def test_what_says_nothing_is_another_structure_and_what_says_much_stays_where_it_is():
    runs = drawn(0, 12, 5.0, 1.0)[1]
    runs[0] = replace(runs[0], mean=np.full(3, 500.0), covariance=np.eye(3) * WIDE**2)
    found = population(runs)
    for name in ("estimate", "lower", "upper"):
        np.testing.assert_allclose(getattr(found.structures, name)[0], getattr(found.another, name), atol=0.1)
    assert (np.abs(found.off[0]) < 1.0).all()
    runs = [replace(each, covariance=each.covariance * 1e-8) for each in drawn(1, 12, 5.0, 1.0)[1][1:]]
    found = population(runs)
    np.testing.assert_allclose(found.structures.estimate, found.alone, rtol=1e-6)
    np.testing.assert_allclose(found.structures.std, found.alone_std, rtol=1e-3)
    np.testing.assert_allclose(found.spread.estimate, np.std(found.alone, axis=0, ddof=1), rtol=0.1)
    found = population(drawn(2, 20, 0.0, 2.0)[1])
    assert (found.spread.lower == 0.0).all()
    assert (found.spread.estimate < 1.0).all()
    assert (np.ptp(found.structures.estimate, axis=0) < 0.3 * np.ptp(found.alone[1:], axis=0)).all()


def test_an_outlier_is_told_and_no_other():
    runs = drawn(3, 20, 2.0, 1.0)[1]
    runs[7] = replace(runs[7], mean=runs[7].mean - np.array([0.0, 25.0, 0.0]))
    found = population(runs)
    assert found.off[7, 1] < -5.0
    assert np.argwhere(found.outlier).tolist() == [[7, 1]]
    others = population(runs[:7] + runs[8:])  # to whom it means nothing, nor they to it
    np.testing.assert_allclose(found.spread.estimate, others.spread.estimate, rtol=0.02)
    np.testing.assert_allclose(found.mean.estimate, others.mean.estimate, rtol=1e-3)
    np.testing.assert_array_equal(found.structures.estimate[7], found.alone[7])


def test_units_and_order_do_not_matter():
    runs = drawn(4, 8, 5.0, 2.0)[1]
    unit, order = np.array([1e6, 1.0, 1e-5]), np.random.default_rng(0).permutation(8)
    other = [
        replace(r, mean=unit * r.mean, covariance=r.covariance * np.outer(unit, unit), first_std=unit * r.first_std)
        for r in runs
    ]
    found, again = population(runs), population([other[i] for i in order])
    for part in ("estimate", "std", "lower", "upper"):
        left, right = getattr(found.structures, part), getattr(again.structures, part) / unit
        np.testing.assert_allclose(left[order], right, rtol=1e-6)
        np.testing.assert_allclose(
            getattr(found.spread, part), getattr(again.spread, part) / unit, rtol=1e-6, atol=1e-9
        )


def test_what_was_believed_of_every_structure_counts_once():
    """Twenty records say 100 +- 5 each, under the belief 90 +- 5: twenty posteriors of 95, and still a mean of 100."""
    generator = np.random.default_rng(5)
    runs = []
    for alone in 100.0 + 5.0 * generator.standard_normal(20):
        posterior = (alone + 90.0) / 2.0
        runs.append(known([posterior], [[12.5]], prescribed=np.array([90.0]), first_std=5.0))
    found = population(runs)
    alone = 2.0 * np.mean([run.mean[0] for run in runs]) - 90.0
    assert found.mean.estimate[0] == pytest.approx(alone, abs=1.0)  # the belief, once, is worth less than one record


def test_no_interval_reaches_below_the_least_value():
    found = population([known([m], [[1.0]]) for m in (-0.5, 0.3, 0.8, 0.1, -0.2)], lower=0.0)
    for part in (found.structures, found.mean, found.another):
        assert (part.lower >= 0.0).all()
        assert ((part.lower <= part.estimate) & (part.estimate <= part.upper)).all()


def test_what_a_misfit_may_hide_makes_a_record_say_less():
    runs = drawn(6, 10, 1.0, 0.1, size=1)[1]
    hiding = replace(runs[4], mean=runs[4].mean + 20.0, told=np.array([10.0]), weight=np.array([0.5]))
    assert hiding.hidden[0] == pytest.approx(20.0, rel=1e-2)
    found = population([*runs[:4], hiding, *runs[5:]])
    assert found.structures.estimate[4, 0] == pytest.approx(found.mean.estimate[0], abs=0.5)
    assert abs(found.off[4, 0]) < 2.0
