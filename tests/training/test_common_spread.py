"""Records one after the other ask for the same common spread as all of them together."""

from dataclasses import replace

import numpy as np
import pytest
from storeys import C, K, M, record

from pinn_cli.model.knowledge import Levels, ParameterKnowledge
from pinn_cli.scheme.problem import JointPrior, Problem
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.training.updating import common_spread, under_spread

PRESCRIBED, FIRST = np.array([2.0, 3.0, 5.0, np.nan]), np.array([0.2, 0.3, 0.5, 50.0])
TRUE = np.array([2.02, 3.02, 4.96, 7.0])
NOTHING = np.zeros(4)


def information(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """What a record of 30 noisy sums of the parameters says: its precision, and that times its own estimate."""
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((30, 4)) / (0.3 * np.array([1.0, 0.5, 1.0, 2.0]))
    return rows.T @ rows, rows.T @ (rows @ TRUE + rng.standard_normal(30))


def posterior(precision: np.ndarray, pull: np.ndarray, spread: float) -> ParameterKnowledge:
    """Under the first prior with a spread."""
    prior = np.where(np.isfinite(PRESCRIBED), 1.0 / (spread * FIRST) ** 2, 1.0 / FIRST**2)
    covariance = np.linalg.inv(precision + np.diag(prior))
    mean = covariance @ (pull + prior * np.nan_to_num(PRESCRIBED))
    return ParameterKnowledge(mean, covariance, NOTHING, NOTHING, FIRST, PRESCRIBED, spread)


def test_knowledge_under_another_spread():
    precision, pull = information(1)
    one, other = (posterior(precision, pull, spread) for spread in (0.9, 0.1))
    found = one.with_spread(0.1)
    np.testing.assert_allclose(found.mean, other.mean, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, other.covariance, rtol=1e-7, atol=1e-12)
    assert found.spread == 0.1
    np.testing.assert_allclose(found.with_spread(0.9).mean, one.mean, rtol=1e-9)
    alone = replace(one, prescribed=None)
    assert alone.with_spread(0.1) is alone
    assert common_spread(alone) == 0.9


def test_the_spread_after_two_records_is_that_of_both_together():
    (first, of_first), (second, of_second) = information(1), information(2)
    lone = posterior(first, of_first, 1.0)
    after_one = lone.with_spread(common_spread(lone))
    both = posterior(first + second, of_first + of_second, 1.0)
    together = both.with_spread(common_spread(both))
    # The second record under what the first leaves, its spread included.
    before = np.linalg.inv(after_one.covariance)
    covariance = np.linalg.inv(before + second)
    mean = covariance @ (before @ after_one.mean + of_second)
    updated = replace(after_one, mean=mean, covariance=covariance)
    assert after_one.spread != pytest.approx(together.spread, rel=0.02)
    assert common_spread(updated) == pytest.approx(together.spread, rel=2e-3)
    again = updated.with_spread(common_spread(updated))
    np.testing.assert_allclose(np.diag(again.covariance), np.diag(together.covariance), rtol=5e-3)
    np.testing.assert_allclose(again.mean, together.mean, rtol=1e-4)


def test_an_update_looks_at_earlier_records_again_under_another_spread():
    structure = build_chain(3, Linear(), m=M.tolist(), c=C.tolist(), k=K.tolist())
    chosen = [p for p in structure.every_parameter() if p.kind in "ck"]
    mean, first = np.concatenate((0.98 * C, 1.01 * K)), np.concatenate((0.1 * C, 10.0 * K))
    std = np.concatenate((0.05 * C, 0.001 * K))
    prescribed = np.concatenate((C, np.full(3, np.nan)))
    known = ParameterKnowledge(mean, np.diag(std**2), np.zeros(6), np.zeros(6), first, prescribed, 1.0)
    uncertain = tuple(
        replace(p, prescribed=float(m), prior_std=float(s), positive=True)
        for p, m, s in zip(chosen, mean, std, strict=True)
    )
    prior = JointPrior.of(known, Levels({}, 1.0, 1.0, 1.0, 1.0))
    problem = Problem(structure, record(1).record, uncertain, "derivative", "free", prior=prior)
    found, asked = under_spread(problem, 0.3), known.with_spread(0.3)
    np.testing.assert_allclose([p.prescribed for p in found.uncertain], asked.mean)
    np.testing.assert_allclose([p.prior_std for p in found.uncertain], np.sqrt(np.diag(asked.covariance)))
    np.testing.assert_allclose(found.structure.parameters["c"], asked.mean[:3])
    assert found.prior.spread == 0.3
    assert (asked.mean[:3] > mean[:3]).all()
