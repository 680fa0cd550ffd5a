"""Jobs: solved in one process, kept one by one, and made again only where something has changed."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pinn_cli.paper.study import results
from pinn_cli.paper.study.job import Job, JobResult, as_json, from_json, solve
from pinn_cli.paper.study.noise_seeds import seed_jobs
from pinn_cli.paper.study.posed import posed
from pinn_cli.paper.study.results import all_rows, make_results, read_results
from pinn_cli.runs.writing import write_json

SMALL = ("system.ndof=2", "simulation.duration=12", "simulation.samples=257", "baseline=kalman_smoother")


@pytest.fixture
def jobs():
    return seed_jobs()[:3]


def test_what_is_up_to_date_is_not_solved_again(tmp_path, solver, jobs):
    first = make_results(jobs, tmp_path, solver)
    again = make_results(jobs, tmp_path, solver)
    assert solver.calls == [job.name for job in jobs]
    assert again.seconds == first.seconds == pytest.approx(7.5)
    pd.testing.assert_frame_equal(all_rows(first, "fitness"), all_rows(again, "fitness"))


def test_an_interruption_loses_nothing(tmp_path, solver, jobs):
    solver.interrupted_after = 2
    with pytest.raises(KeyboardInterrupt):
        make_results(jobs, tmp_path, solver)
    assert [job.name for job in read_results(jobs, tmp_path).missing] == [jobs[2].name]
    solver.interrupted_after = None
    assert not make_results(jobs, tmp_path, solver).missing
    assert solver.calls == [job.name for job in jobs]


def test_a_change_of_code_or_configuration_makes_all_again(tmp_path, solver, jobs, monkeypatch):
    make_results(jobs, tmp_path, solver)
    monkeypatch.setattr(results, "_settings_digest", lambda overrides: f"other {overrides}")
    assert len(read_results(jobs, tmp_path).missing) == 3
    make_results(jobs, tmp_path, solver)
    assert len(solver.calls) == 6


def test_one_that_is_refused_is_told_and_the_others_are_solved(tmp_path, solver, jobs, capsys):
    solver.refused = {jobs[1].name}
    found = make_results(jobs, tmp_path, solver)
    assert [job.name for job in found.missing] == [jobs[1].name]
    assert "system.kappa=-1" in found.failures[0]
    assert "system.kappa=-1" in capsys.readouterr().err


def test_one_that_diverged_is_a_result(tmp_path, solver, jobs):
    solver.diverging = {jobs[0].name}
    found = make_results(jobs, tmp_path, solver)
    assert not found.missing
    assert found.failures == [f"{jobs[0].name}: loss is not finite"]
    assert set(all_rows(found, "fitness")["seed"]) == {1, 2}


@pytest.mark.parametrize("content", [{}, {"digest": "d"}, {"digest": None, "fitness": 3}])
def test_what_cannot_be_read_is_missing(tmp_path, jobs, content):
    write_json(content, tmp_path / f"{jobs[0].name}.json")
    assert read_results(jobs, tmp_path).missing == jobs


def test_a_result_comes_back(solver, jobs):
    result = solver(jobs[0])
    result.fitness.loc[0, "fitness_percent"] = np.nan
    back = from_json(as_json(JobResult(result.fitness, result.parameters, result.seconds, float("nan"), "")))
    pd.testing.assert_frame_equal(back.fitness, result.fitness)
    assert np.isnan(back.strength)


def test_columns_of_the_job_come_first(tmp_path, solver):
    job = Job("none_kappa10_force1_seed0", (), 0, columns=(("kappa", 10.0),))
    rows = all_rows(make_results([job], tmp_path, solver), "fitness")
    assert list(rows)[:2] == ["kappa", "strength"]
    assert set(rows["strength"]) == {0.01}


def test_the_seed_draws_the_noise_and_leaves_the_force():
    case = ("experiment=paper/sr_6dof_snr20", "simulation.samples=513")
    first, second = (posed(Job("", case, seed).command) for seed in (0, 1))
    published = posed(case)
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
    first, second = (posed(Job("", SMALL, seed, redraws_force=True).command) for seed in (0, 1))
    force = np.stack([one.truth.response.force[:, 0] for one in (first, second)])
    assert abs(np.corrcoef(force)[0, 1]) < 0.9
    assert not np.array_equal(force[0], force[1])


def test_a_job_is_solved_by_both_and_scored():
    result = solve(Job("small", SMALL, 3))
    assert set(result.fitness["estimator"]) == {"pinn", "kalman_smoother"}
    assert set(result.fitness["seed"]) == {3}
    assert not result.fitness["group"].str.startswith("dof_").any()
    every = result.fitness[(result.fitness["group"] == "all") & (result.fitness["quantity"] == "velocity")]
    assert (every["fitness_percent"] > 95.0).all()
    assert set(result.parameters["parameter"]) == {"c_1", "c_2", "k_1", "k_2", "kappa_1", "kappa_2"}
    assert {"record", "estimate", "baseline", "total"} <= set(result.seconds)
    assert 0.0 < result.strength < 10.0


def test_a_chain_without_kappa_has_no_strength():
    assert np.isnan(solve(Job("linear", (*SMALL, "system=linear"), 0)).strength)
