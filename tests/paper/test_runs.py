"""Which runs are made, and when one is made again."""

from __future__ import annotations

import subprocess
import sys
import threading
from types import SimpleNamespace

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from pinn_cli.paper import digests
from pinn_cli.paper.cases import TABLES, PlannedRun, Variant, planned_runs
from pinn_cli.paper.runs import FINISHED, CaseFailedError, make_runs, run_case
from pinn_cli.runs.writing import write_json
from pinn_cli.settings.override_syntax import quoted


@pytest.fixture
def planned():
    return planned_runs(TABLES[1:])[:3]


def test_every_case_once_per_variant():
    runs = planned_runs()
    names = [run.name for run in runs]
    assert len(names) == len(set(names)) == 6 * 2 + 6 * 2 + 2 * 3
    assert names[:3] == ["sr_6dof_perturbed_uncertain", "sr_6dof_snr50_uncertain", "sr_6dof_snr50_fixed"]
    assert {name.rpartition("_")[2] for name in names if name.startswith("pe_")} == {
        "marginal", "conditional", "laplace"
    }  # fmt: skip
    beside = {run.variant.name for run in runs if "baseline=kalman_smoother" in run.variant.overrides}
    assert beside == {"uncertain", "marginal"}


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
        monkeypatch.setattr(digests, "source_digest", lambda: "another")
    elif what == "versions":
        monkeypatch.setattr(digests, "package_versions", lambda: {"numpy": "0"})
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
    monkeypatch.setattr(digests, "source_digest", lambda: "another")
    runner.failing = {planned[0].case: KeyboardInterrupt()}
    with pytest.raises(KeyboardInterrupt):
        make_runs(planned[:1], tmp_path, runner)
    assert not (tmp_path / planned[0].name / FINISHED).exists()


def test_a_failure_is_told_and_the_others_are_made(tmp_path, runner, planned, capsys):
    runner.failing = {"sr_6dof_snr50": CaseFailedError("sr_6dof_snr50: exit status 3")}
    finished, failures = make_runs(planned, tmp_path, runner)
    assert [run.planned.case for run in finished] == ["sr_6dof_snr20"]
    assert failures == ["sr_6dof_snr50: exit status 3"] * 2
    assert "exit status 3" in capsys.readouterr().err


def test_the_smoother_is_a_variant_of_its_own(tmp_path, runner, planned):
    finished, _ = make_runs(planned[:1], tmp_path, runner)
    ours, smoother = finished[0].scores
    assert (ours.variant, ours.seconds, ours.process_seconds) == ("uncertain", 4.0, 5.0)
    assert (smoother.variant, smoother.seconds) == ("kalman_smoother", 1.0)
    assert set(smoother.fitness["estimator"]) == {"kalman_smoother"}
    assert len(ours.fitness) == len(smoother.fitness) == 10


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
    with pytest.raises(CaseFailedError, match=rf"sr_6dof_snr50, plain: exit status {status}\n{tail}"):
        run_case(PlannedRun("sr_6dof_snr50", Variant("plain", "plain")), tmp_path)


def test_what_is_kept_is_had_under_its_digest_alone(tmp_path):
    file = tmp_path / "kept.json"
    assert digests.kept(file, "d") is None
    digests.keep({"process_seconds": 3.0}, "d", file)
    assert digests.kept(file, "d") == {"process_seconds": 3.0}
    assert digests.kept(file, "other") is None
    for content in ("", "[]", "{", "{}", '{"digest": null}'):
        file.write_text(content)
        assert digests.kept(file, "d") is None


def test_digest_of_a_tree(tmp_path):
    (tmp_path / "inner").mkdir()
    (tmp_path / "a.py").write_text("1")
    (tmp_path / "inner" / "b.py").write_text("2")
    first = digests.tree_digest(tmp_path, "*.py")
    (tmp_path / "note.txt").write_text("no module")
    assert digests.tree_digest(tmp_path, "*.py") == first
    (tmp_path / "inner" / "b.py").write_text("3")
    changed = digests.tree_digest(tmp_path, "*.py")
    (tmp_path / "inner" / "b.py").rename(tmp_path / "inner" / "c.py")
    assert len({first, changed, digests.tree_digest(tmp_path, "*.py")}) == 3
    without = digests.tree_digest(tmp_path, "*.py", ("inner/",))
    (tmp_path / "inner" / "c.py").unlink()
    assert digests.tree_digest(tmp_path, "*.py") == without
    package = digests.Path(digests.__file__).parents[1]
    assert all((package / part).exists() for part in digests.READERS)
