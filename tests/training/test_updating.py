"""What a record says against those before it, and the common spread that records ask for one after the other."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from storeys import C, K, M, record

from pinn_cli.model.knowledge import ParameterKnowledge
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.changes import IMPROBABLE, common_spread, found_changes, left_open, released, under_spread
from pinn_cli.training.estimate import Changes

P = 6


@dataclass
class Case:
    """Earlier records know theta with covariance C; a new one measures it with covariance R."""

    truth: np.ndarray
    C: np.ndarray
    R: np.ndarray


def case(seed: int = 0) -> Case:
    rng = np.random.default_rng(seed)
    roots = rng.standard_normal((2, P, P))
    C, R = (root @ root.T / P + 0.3 * np.eye(P) for root in roots)
    return Case(100.0 + rng.uniform(0.0, 50.0, P), C, 2.0 * R)


def solved(given: Case, rng: np.random.Generator, change: np.ndarray, hidden: float = 0.0):
    """Problem and posterior of one draw of both."""
    mean = given.truth + np.linalg.cholesky(given.C) @ rng.standard_normal(P)
    measured = given.truth + change + np.linalg.cholesky(given.R) @ rng.standard_normal(P)
    std = np.sqrt(np.diag(given.C))
    weight = np.full(P, 1.0)
    prior = ParameterKnowledge(mean, given.C, hidden * weight, weight, 100.0 * std)
    uncertain = tuple(Parameter("k", i, mean[i], std[i]) for i in range(P))
    problem = Problem(None, None, uncertain, prior=prior)  # type: ignore[arg-type]
    covariance = np.linalg.inv(np.linalg.inv(given.C) + np.linalg.inv(given.R))
    peak = covariance @ (np.linalg.solve(given.C, mean) + np.linalg.solve(given.R, measured))
    known = ParameterKnowledge(peak, covariance, 2 * hidden * weight, 2 * weight, 100.0 * std)
    return problem, known, measured


def with_the_third_changed(seed: int):
    """Problem and posterior of a draw whose third parameter became another one, by many standard deviations."""
    return solved(case(), np.random.default_rng(seed), 40.0 * np.eye(P)[2])


def prior_covariance(problem: Problem) -> np.ndarray:
    std = np.array([p.prior_std for p in problem.uncertain])
    return problem.prior.correlation * np.outer(std, std)


def test_alone_is_what_the_record_says_by_itself():
    given = case()
    problem, known, measured = solved(given, np.random.default_rng(1), np.zeros(P))
    changes = found_changes(problem, known)
    np.testing.assert_allclose(changes.alone, measured, rtol=1e-8)
    np.testing.assert_allclose(changes.alone_std, np.sqrt(np.diag(given.R)), rtol=1e-8)
    np.testing.assert_allclose(changes.before_std, np.sqrt(np.diag(given.C)), rtol=1e-8)


def test_false_alarms_and_the_probability_of_the_whole():
    given, rng = case(), np.random.default_rng(2)
    every = [found_changes(*solved(given, rng, np.zeros(P))[:2]) for _ in range(2000)]
    assert sum(bool(changes.found) for changes in every) <= 10  # 2 on average
    chances = np.sort([changes.chance for changes in every])
    assert np.abs(chances - (np.arange(2000) + 0.5) / 2000).max() < 0.05  # uniform


def test_a_change_is_found_with_its_size_and_its_place():
    given, rng = case(), np.random.default_rng(3)
    V = np.linalg.inv(given.C + given.R)
    std = V[2, 2] ** -0.5
    change = np.zeros(P)
    change[2] = -8.0 * std
    errors = []
    for _ in range(300):
        problem, known, _ = solved(given, rng, change)
        changes = found_changes(problem, known)
        assert changes.found
        first = changes.found[0]
        if first.parameter.index == 2 and len(changes.found) == 1:
            assert first.std == pytest.approx(std)
            assert first.chance < IMPROBABLE
            errors.append((first.by - change[2]) / std)
    assert len(errors) > 290
    assert abs(np.mean(errors)) < 0.2
    assert np.std(errors) == pytest.approx(1.0, abs=0.15)


def parameters_of(changes: Changes) -> list[Parameter]:
    return [change.parameter for change in changes.found]


def test_with_changed_parameters_released_it_says_the_same():
    given = case()
    problem, known, measured = with_the_third_changed(seed=8)
    changes = found_changes(problem, known)
    again = released(problem, parameters_of(changes))
    prior = prior_covariance(again)
    covariance = np.linalg.inv(np.linalg.inv(prior) + np.linalg.inv(given.R))
    mean = np.array([p.prescribed for p in problem.uncertain])
    peak = covariance @ (np.linalg.solve(prior, mean) + np.linalg.solve(given.R, measured))
    second = found_changes(problem, replace(known, mean=peak, covariance=covariance), again)
    np.testing.assert_allclose(second.alone, measured, rtol=1e-7)
    np.testing.assert_allclose(second.alone_std, changes.alone_std, rtol=1e-7)
    assert second.found[0].by == pytest.approx(changes.found[0].by, rel=1e-7)
    assert second.found[0].std == pytest.approx(changes.found[0].std, rel=1e-7)


def test_of_what_changed_nothing_is_handed_over():
    problem, known, _ = with_the_third_changed(seed=9)
    changes = found_changes(problem, known)
    handed = left_open(known, problem, parameters_of(changes))
    assert np.sqrt(handed.covariance[2, 2]) > 100.0
    assert (handed.weight == np.array([2.0, 2.0, 0.0, 2.0, 2.0, 2.0])).all()
    others = np.arange(P) != 2
    np.testing.assert_array_equal(handed.of(others).covariance, known.of(others).covariance)
    np.testing.assert_array_equal(handed.mean, known.mean)
    assert known.weight[2] == 2.0


def test_the_share_says_which_parameter_it_is():
    given, rng = case(), np.random.default_rng(4)
    V = np.linalg.inv(given.C + given.R)
    shares, hits = [], []
    for _ in range(400):
        j, change = rng.integers(P), np.zeros(P)
        change[j] = 5.5 * V[j, j] ** -0.5
        found = found_changes(*solved(given, rng, change)[:2]).found
        if found:
            shares.append(found[0].share)
            hits.append(found[0].parameter.index == j)
    assert np.mean(hits) == pytest.approx(np.mean(shares), abs=0.06)


def test_what_the_model_leaves_out_explains_differences():
    given, rng = case(), np.random.default_rng(5)
    change = np.zeros(P)
    change[2] = 8.0 * np.linalg.inv(given.C + given.R)[2, 2] ** -0.5
    problem, known, _ = solved(given, rng, change, hidden=20.0)
    assert not found_changes(problem, known).found


def test_a_record_that_tells_one_direction_only():
    given = case()
    problem, _, _ = solved(given, np.random.default_rng(6), np.zeros(P))
    mean = np.array([p.prescribed for p in problem.uncertain])
    row = np.eye(P)[3] / 0.1
    covariance = np.linalg.inv(np.linalg.inv(given.C) + np.outer(row, row))
    peak = mean + covariance @ row * (row[3] * 30.0)
    changes = found_changes(problem, ParameterKnowledge(peak, covariance, *np.zeros((2, P)), np.ones(P)))
    assert np.isnan(changes.alone).all()
    assert [change.parameter.index for change in changes.found] == [3]
    assert changes.found[0].by == pytest.approx(30.0, rel=0.01)
    assert changes.found[0].std == pytest.approx(np.hypot(0.1, np.sqrt(given.C[3, 3])), rel=0.01)


def test_two_changes_are_sized_together():
    given, rng = case(), np.random.default_rng(9)
    change = np.zeros(P)
    change[[1, 4]] = -60.0, 45.0
    errors = []
    for _ in range(100):
        found = found_changes(*solved(given, rng, change)[:2]).found
        assert {one.parameter.index for one in found} >= {1, 4}
        if len(found) == 2:
            errors += [(one.by - change[one.parameter.index]) / one.std for one in found]
    assert len(errors) > 180
    assert abs(np.mean(errors)) < 0.25
    assert np.std(errors) == pytest.approx(1.0, abs=0.15)


def test_released_opens_the_changed_parameter_alone():
    problem, known, _ = with_the_third_changed(seed=7)
    changes = found_changes(problem, known)
    assert [found.parameter.index for found in changes.found] == [2]
    opened = prior_covariance(released(problem, parameters_of(changes))) - case().C
    assert opened[2, 2] >= problem.uncertain[2].prescribed ** 2
    opened[2, 2] = 0.0
    np.testing.assert_allclose(opened, 0.0, atol=1e-9)


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
    problem = Problem(structure, record(1).record, uncertain, "derivative", "free", prior=known)
    found, asked = under_spread(problem, 0.3), known.with_spread(0.3)
    np.testing.assert_allclose([p.prescribed for p in found.uncertain], asked.mean)
    np.testing.assert_allclose([p.prior_std for p in found.uncertain], np.sqrt(np.diag(asked.covariance)))
    np.testing.assert_allclose(found.structure.parameters["c"], asked.mean[:3])
    assert found.prior.spread == 0.3
    assert (asked.mean[:3] > mean[:3]).all()
