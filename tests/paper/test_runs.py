"""What is made, of runs and of realisations, and when it is made again."""

import subprocess
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from pinn_cli.cli.composing import compose_config
from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.prepare import prepare_problem
from pinn_cli.paper import realisations as realised
from pinn_cli.paper import runs
from pinn_cli.paper.realisations import Realisation, ScoredRealisations, solve
from pinn_cli.paper.runs import TABLES, CaseFailedError, PlannedRun, Variant, make_runs, planned_runs, run_case
from pinn_cli.paper.studies import nonlinearity_realisations, seed_realisations
from pinn_cli.runs.writing import write_json
from pinn_cli.settings.override_syntax import quoted

SMALL = ("system.ndof=2", "simulation.duration=12", "simulation.samples=257", "baseline=kalman_smoother")


@pytest.fixture
def planned():
    return planned_runs(TABLES[1:])[:3]


@pytest.fixture
def realisations(quick):
    return seed_realisations()[:3]


def test_every_case_once_per_variant_and_every_realisation_once():
    names = [run.name for run in planned_runs()]
    assert len(names) == len(set(names)) == 6 * 2 + 6 * 2 + 2 * 3
    assert names[:3] == ["sr_6dof_perturbed_uncertain", "sr_6dof_snr50_uncertain", "sr_6dof_snr50_fixed"]
    for realisations in (seed_realisations(), nonlinearity_realisations()):
        assert len(realisations) == len({one.name for one in realisations}) == 120
        assert len({one.overrides for one in realisations}) == 120


def test_runs_are_made_at_once(tmp_path, runner, planned):
    """Each waits for another one to have begun."""
    together = threading.Barrier(2, timeout=20)

    def waiting(run, directory):
        together.wait()
        return runner(run, directory)

    finished, failures = make_runs(planned[:2], tmp_path, waiting, at_once=2)
    assert [run.planned for run in finished] == planned[:2]
    assert not failures


@pytest.mark.parametrize("what", ["nothing", "configuration", "code", "versions"])
def test_a_change_makes_every_run_again(tmp_path, runner, planned, monkeypatch, what):
    make_runs(planned, tmp_path, runner)
    if what == "configuration":
        monkeypatch.setattr(PlannedRun, "overrides", ("seed=1",))
    elif what == "code":
        monkeypatch.setattr(runs, "source_digest", lambda: "another")
    elif what == "versions":
        monkeypatch.setattr(runs, "package_versions", lambda: {"numpy": "0"})
    again, failures = make_runs(planned, tmp_path, runner)
    assert not failures
    assert [run.process_seconds for run in again] == [5.0] * 3
    assert runner.calls == (1 if what == "nothing" else 2) * [run.name for run in planned]


def test_an_interrupted_paper_goes_on_with_what_is_missing(tmp_path, runner, planned, monkeypatch):
    runner.failing = {planned[2].case: KeyboardInterrupt()}
    with pytest.raises(KeyboardInterrupt):
        make_runs(planned, tmp_path, runner)
    runner.failing = {}
    finished, _ = make_runs(planned, tmp_path, runner)
    assert len(finished) == 3
    assert runner.calls == [run.name for run in planned]
    # One that is out of date does not look finished while it runs.
    monkeypatch.setattr(runs, "source_digest", lambda: "another")
    runner.failing = {planned[0].case: KeyboardInterrupt()}
    with pytest.raises(KeyboardInterrupt):
        make_runs(planned[:1], tmp_path, runner)
    monkeypatch.undo()
    assert len(runs.read_runs(planned, tmp_path)) == 2


def test_a_failure_is_told_and_the_others_are_made(tmp_path, runner, planned, capsys):
    runner.failing = {"sr_6dof_snr50": CaseFailedError("exit status 3")}
    finished, failures = make_runs(planned, tmp_path, runner)
    assert [run.planned.case for run in finished] == ["sr_6dof_snr20"]
    assert failures == [f"sr_6dof_snr50_{name}: exit status 3" for name in ("uncertain", "fixed")]
    assert "exit status 3" in capsys.readouterr().err


def test_the_smoother_is_a_variant_of_its_own(tmp_path, runner, planned):
    finished, _ = make_runs(planned[:1], tmp_path, runner)
    table = finished[0].table("fitness")
    seconds = table.groupby("variant")[["seconds", "process_seconds"]].max()
    assert seconds.loc["uncertain"].tolist() == [4.0, 5.0]
    assert seconds.loc["kalman_smoother"].tolist() == [1.0, 1.0]
    assert table["variant"].value_counts().to_dict() == {"uncertain": 10, "kalman_smoother": 10}


def test_a_run_is_a_command_in_a_folder_of_any_name(tmp_path, monkeypatch):
    commands = []
    directory = tmp_path / "a folder, with = signs"

    def call(command, **_):
        commands.append(command)
        write_json({}, directory / "run.json")
        return SimpleNamespace(returncode=0, stdout="", stderr="")

    monkeypatch.setattr(subprocess, "run", call)
    assert run_case(planned_runs(TABLES[1:2])[1], directory) < 1.0
    assert commands[0][:5] == [
        sys.executable, "-m", "pinn_cli.main", "experiment=paper/sr_6dof_snr50", "scheme.parameter_uncertainty=0"
    ]  # fmt: skip
    assert commands[0][5] == f"hydra.run.dir='{directory}'"
    parser = OverridesParser.create()
    for name in ("/a/b c", "/it's", "/x=1,2", "/back\\slash", "/a\\'b", "/end\\"):
        assert parser.parse_override(f"hydra.run.dir={quoted(name)}").value() == name


@pytest.mark.parametrize(("status", "tail"), [(0, ""), (3, "what went wrong")])
def test_results_of_an_earlier_run_do_not_pass_for_this_one(tmp_path, monkeypatch, status, tail):
    write_json({"seconds": {"total": 2.0}}, tmp_path / "run.json")
    done = SimpleNamespace(returncode=status, stdout="", stderr=tail)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: done)
    with pytest.raises(CaseFailedError, match=rf"exit status {status}\n{tail}"):
        run_case(PlannedRun("sr_6dof_snr50", Variant("plain", "plain")), tmp_path)


@pytest.mark.parametrize("content", ["", "[]", "{", "{}", '{"digest": null}', '{"digest": "other"}'])
def test_what_is_kept_is_had_under_its_digest_alone(tmp_path, content):
    one = SimpleNamespace(name="kept", digest="d")
    assert runs.kept(one, tmp_path) is None
    runs.make_missing([one], tmp_path, lambda _: {"process_seconds": 3.0})
    assert runs.kept(one, tmp_path) == {"process_seconds": 3.0}
    (tmp_path / "kept.json").write_text(content)
    assert runs.kept(one, tmp_path) is None


def test_digest_of_a_tree(tmp_path):
    (tmp_path / "inner").mkdir()
    (tmp_path / "a.py").write_text("1")
    (tmp_path / "inner" / "b.py").write_text("2")
    first = runs.tree_digest(tmp_path, "*.py")
    (tmp_path / "note.txt").write_text("no module")
    assert runs.tree_digest(tmp_path, "*.py") == first
    (tmp_path / "inner" / "b.py").write_text("3")
    changed = runs.tree_digest(tmp_path, "*.py")
    (tmp_path / "inner" / "b.py").rename(tmp_path / "inner" / "c.py")
    assert len({first, changed, runs.tree_digest(tmp_path, "*.py")}) == 3
    without = runs.tree_digest(tmp_path, "*.py", ("inner/",))
    (tmp_path / "inner" / "c.py").unlink()
    assert runs.tree_digest(tmp_path, "*.py") == without
    package = runs.Path(runs.__file__).parents[1]
    assert all((package / part).exists() for part in runs.READERS)


def test_a_change_solves_all_realisations_again(tmp_path, solver, realisations, monkeypatch):
    first, again = (ScoredRealisations.made(realisations, tmp_path, solver) for _ in range(2))
    assert again.seconds == first.seconds == pytest.approx(7.5)
    pd.testing.assert_frame_equal(first.rows("fitness"), again.rows("fitness"))
    monkeypatch.setattr(realised, "_settings_digest", lambda overrides: f"other {overrides}")
    assert len(ScoredRealisations.read(realisations, tmp_path).missing) == 3
    ScoredRealisations.made(realisations, tmp_path, solver)
    assert solver.calls == 2 * [one.name for one in realisations]


def test_one_that_is_refused_is_told_and_one_that_diverged_is_a_result(tmp_path, solver, realisations, capsys):
    solver.refused, solver.diverging = {realisations[1].name}, {realisations[0].name}
    found = ScoredRealisations.made(realisations, tmp_path, solver)
    assert [one.name for one in found.missing] == [realisations[1].name]
    assert found.failures[0] == f"{realisations[0].name}: loss is not finite"
    assert "system.kappa=-1" in found.failures[1]
    assert "system.kappa=-1" in capsys.readouterr().err
    assert set(found.rows("fitness")["seed"]) == {2}


def test_columns_of_the_realisation_come_first_and_what_is_unknown_comes_back(tmp_path, solver):
    def unscored(one):
        scores = solver(one)
        scores["fitness"][0]["fitness_percent"] = np.nan
        return scores

    one = Realisation("none_kappa10_force1_seed0", (), 0, columns=(("kappa", 10.0),))
    rows = ScoredRealisations.made([one], tmp_path, unscored).rows("fitness")
    assert list(rows)[:2] == ["kappa", "strength"]
    assert set(rows["strength"]) == {0.01}
    assert rows["fitness_percent"].isna().tolist() == [True] + [False] * (len(rows) - 1)


def prepared(*overrides):
    return prepare_problem(RunConfig.read(compose_config(overrides)))


def test_the_seed_draws_the_noise_and_the_force_where_it_is_asked_for():
    case = ("experiment=paper/sr_6dof_snr20", "simulation.samples=513")
    first, second = (prepared(*Realisation("", case, seed).overrides) for seed in (0, 1))
    published = prepared(*case)
    for quantity in ("acceleration", "force"):
        truths = [getattr(one.truth.response, quantity) for one in (first, second, published)]
        np.testing.assert_array_equal(truths[0], truths[1])
        np.testing.assert_array_equal(truths[0], truths[2])
        noises = [(getattr(one.record, quantity) - truths[0])[:, 0] for one in (first, second, published)]
        assert np.abs(np.corrcoef(noises) - np.eye(3)).max() < 0.2
        power = np.mean(truths[0][:, 0] ** 2) / np.mean(noises[0] ** 2)
        assert 10.0 * np.log10(power) == pytest.approx(20.0, abs=0.6)
    anew = prepared(*Realisation("", case, 1, redraws_force=True).overrides).truth.response.force[:, 0]
    assert abs(np.corrcoef(anew, second.truth.response.force[:, 0])[0, 1]) < 0.9


def test_a_realisation_is_solved_by_both_and_scored():
    result = solve(Realisation("small", SMALL, 3))
    fitness, parameters = pd.DataFrame(result["fitness"]), pd.DataFrame(result["parameters"])
    assert set(fitness["estimator"]) == {"pinn", "kalman_smoother"}
    assert set(fitness["seed"]) == {3}
    assert not fitness["group"].str.startswith("dof_").any()
    every = fitness[(fitness["group"] == "all") & (fitness["quantity"] == "velocity")]
    assert (every["fitness_percent"] > 95.0).all()
    assert set(parameters["parameter"]) == {"c_1", "c_2", "k_1", "k_2", "kappa_1", "kappa_2"}
    assert {"record", "estimate", "baseline", "total"} <= set(result["seconds"])
    assert 0.0 < result["strength"] < 10.0
    assert solve(Realisation("linear", (*SMALL, "system=linear"), 0))["strength"] is None
