"""Realisations: solved in one process, kept one by one, and made again only where something has changed."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pinn_cli.cli.composing import compose_config
from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.prepare import prepare_problem
from pinn_cli.paper import realisations as realised
from pinn_cli.paper.realisations import Realisation, Scores, read_scores, solve, solve_missing
from pinn_cli.paper.seeds import seed_realisations

pytestmark = pytest.mark.usefixtures("quick")

SMALL = ("system.ndof=2", "simulation.duration=12", "simulation.samples=257", "baseline=kalman_smoother")


def prepared(*overrides):
    return prepare_problem(RunConfig.read(compose_config(overrides)))


@pytest.fixture
def realisations():
    return seed_realisations()[:3]


def test_what_is_up_to_date_is_not_solved_again(tmp_path, solver, realisations):
    first = solve_missing(realisations, tmp_path, solver)
    again = solve_missing(realisations, tmp_path, solver)
    assert solver.calls == [one.name for one in realisations]
    assert again.seconds == first.seconds == pytest.approx(7.5)
    pd.testing.assert_frame_equal(first.rows("fitness"), again.rows("fitness"))


def test_an_interruption_loses_nothing(tmp_path, solver, realisations):
    solver.interrupted_after = 2
    with pytest.raises(KeyboardInterrupt):
        solve_missing(realisations, tmp_path, solver)
    assert [one.name for one in read_scores(realisations, tmp_path).missing] == [realisations[2].name]
    solver.interrupted_after = None
    assert not solve_missing(realisations, tmp_path, solver).missing
    assert solver.calls == [one.name for one in realisations]


def test_a_change_of_code_or_configuration_makes_all_again(tmp_path, solver, realisations, monkeypatch):
    solve_missing(realisations, tmp_path, solver)
    monkeypatch.setattr(realised, "_settings_digest", lambda overrides: f"other {overrides}")
    assert len(read_scores(realisations, tmp_path).missing) == 3
    solve_missing(realisations, tmp_path, solver)
    assert len(solver.calls) == 6


def test_one_that_is_refused_is_told_and_the_others_are_solved(tmp_path, solver, realisations, capsys):
    solver.refused = {realisations[1].name}
    found = solve_missing(realisations, tmp_path, solver)
    assert [one.name for one in found.missing] == [realisations[1].name]
    assert "system.kappa=-1" in found.failures[0]
    assert "system.kappa=-1" in capsys.readouterr().err


def test_one_that_diverged_is_a_result(tmp_path, solver, realisations):
    solver.diverging = {realisations[0].name}
    found = solve_missing(realisations, tmp_path, solver)
    assert not found.missing
    assert found.failures == [f"{realisations[0].name}: loss is not finite"]
    assert set(found.rows("fitness")["seed"]) == {1, 2}


def test_scores_come_back(tmp_path, solver, realisations):
    def unscored(one):
        scores = solver(one)
        scores.fitness[0]["fitness_percent"] = np.nan
        return Scores(scores.fitness, scores.parameters, scores.seconds, None)

    (back,) = solve_missing(realisations[:1], tmp_path, unscored).found.values()
    assert back.fitness[0]["fitness_percent"] is None
    assert back.fitness[1:] == solver(realisations[0]).fitness[1:]
    assert back.strength is None


def test_columns_of_the_realisation_come_first(tmp_path, solver):
    one = Realisation("none_kappa10_force1_seed0", (), 0, columns=(("kappa", 10.0),))
    rows = solve_missing([one], tmp_path, solver).rows("fitness")
    assert list(rows)[:2] == ["kappa", "strength"]
    assert set(rows["strength"]) == {0.01}


def test_the_seed_draws_the_noise_and_leaves_the_force():
    case = ("experiment=paper/sr_6dof_snr20", "simulation.samples=513")
    first, second = (prepared(*Realisation("", case, seed).overrides) for seed in (0, 1))
    published = prepared(*case)
    for quantity in ("acceleration", "force"):
        truths = [getattr(one.truth.response, quantity) for one in (first, second, published)]
        np.testing.assert_array_equal(truths[0], truths[1])
        np.testing.assert_array_equal(truths[0], truths[2])
        noises = [(getattr(one.record, quantity) - truths[0])[:, 0] for one in (first, second, published)]
        for one, other in ((0, 1), (0, 2), (1, 2)):
            assert abs(np.corrcoef(noises[one], noises[other])[0, 1]) < 0.2
        power = np.mean(truths[0][:, 0] ** 2) / np.mean(noises[0] ** 2)
        assert 10.0 * np.log10(power) == pytest.approx(20.0, abs=0.6)


def test_the_force_is_drawn_anew_where_it_is_asked_for():
    first, second = (prepared(*Realisation("", SMALL, seed, redraws_force=True).overrides) for seed in (0, 1))
    force = np.stack([one.truth.response.force[:, 0] for one in (first, second)])
    assert abs(np.corrcoef(force)[0, 1]) < 0.9
    assert not np.array_equal(force[0], force[1])


def test_a_realisation_is_solved_by_both_and_scored():
    result = solve(Realisation("small", SMALL, 3))
    fitness, parameters = pd.DataFrame(result.fitness), pd.DataFrame(result.parameters)
    assert set(fitness["estimator"]) == {"pinn", "kalman_smoother"}
    assert set(fitness["seed"]) == {3}
    assert not fitness["group"].str.startswith("dof_").any()
    every = fitness[(fitness["group"] == "all") & (fitness["quantity"] == "velocity")]
    assert (every["fitness_percent"] > 95.0).all()
    assert set(parameters["parameter"]) == {"c_1", "c_2", "k_1", "k_2", "kappa_1", "kappa_2"}
    assert {"record", "estimate", "baseline", "total"} <= set(result.seconds)
    assert 0.0 < result.strength < 10.0


def test_a_chain_without_kappa_has_no_strength():
    assert solve(Realisation("linear", (*SMALL, "system=linear"), 0)).strength is None
