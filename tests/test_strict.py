"""strict=true: a verdict other than sound is exit status 4, whose results are written all the same."""

from pathlib import Path

import pandas as pd
import pytest
from calls import SMALL, PinnRun

from pinn_cli.report import run_report
from pinn_cli.verdict.finding import Finding, Verdict

DOUBT = Verdict.of([Finding("gain", "acceleration of DOF 3", "the acceleration of DOF 3 is 1.15 times too large")])
QUICK = (*SMALL, "figures=false")


@pytest.fixture
def doubted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_report, "judge", lambda *_: DOUBT)


def test_the_verdict_is_told_and_status_4_where_it_is_strict(pinn_run: PinnRun, doubted: None) -> None:
    """In the line before the directory and in run.json."""
    done = pinn_run(*QUICK, "strict=true")
    assert done.status == 4
    assert done.out.splitlines()[-3:-1] == [f"- {DOUBT.reasons[0].text}", "verdict: questionable"]
    record = done.record
    assert (record["verdict"], record["reasons"]) == ("questionable", [DOUBT.reasons[0].text])
    assert done.err.splitlines()[-1].startswith("pinn-run: the verdict is questionable, and strict=true: the accel")
    assert (done.directory / "fitness.csv").is_file()
    again = pinn_run(f"resume={done.directory}")
    assert (again.status, again.out.splitlines()[0]) == (4, "finished before, nothing to do")
    assert pinn_run(f"resume={done.directory}", "strict=false").status == 0


def test_a_sound_run_passes(pinn_run: PinnRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_report, "judge", lambda *_: Verdict.of([]))
    done = pinn_run(*QUICK, "strict=true")
    assert (done.status, done.out.splitlines()[-2]) == (0, "verdict: sound")


@pytest.mark.slow
def test_in_a_sweep_a_job_that_is_not_sound_failed(pinn_run: PinnRun, doubted: None, tmp_path: Path) -> None:
    command = ("--multirun", *QUICK, "seed=0,1", "strict=true")
    done = pinn_run(*command)
    assert done.status == 4
    jobs = pd.read_csv(done.directory / "jobs.csv")
    assert list(jobs["status"]) == ["failed", "failed"]
    assert all("1.15 times too large" in reason for reason in jobs["reason"])
    assert all((done.directory / name / "fitness.csv").is_file() for name in jobs["directory"])
    written = [(done.directory / name / "run.json").stat().st_mtime_ns for name in jobs["directory"]]
    assert pinn_run(*command).status == 4  # told again, and not run again
    assert written == [(done.directory / name / "run.json").stat().st_mtime_ns for name in jobs["directory"]]


def test_no_boolean_is_refused(pinn_run: PinnRun) -> None:
    done = pinn_run("strict=perhaps")
    assert (done.status, "true or false" in done.err) == (2, True)
