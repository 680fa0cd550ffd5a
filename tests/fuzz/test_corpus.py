"""Every input that ever failed is refused in one line, or has a sound result, and the judge sees what must not be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from fuzz.judge import LONGEST_LINE, Judge, Outcome, import_everything
from fuzz.starts import Starts
from fuzz.trial import Trial

CORPUS = sorted((Path(__file__).parent / "corpus").glob("*.json"))
# Inputs that take long, and families of such: a whole estimate, or all the time that a reader may take.
LONG = {
    "numbers", "physics", "disk", "terminal", "csv-7e425c516b", "csv-12f0fd67e6",
    "directories-023ccd1569", "bombs-245f9af192", "bombs-496ea42d09", "bombs-6408ddf675", "bombs-7d0fef6c52",
    "bombs-804c8eba4e", "bombs-a7a59722df", "csv-d6dc8d3d69", "directories-01af4ba74f", "directories-029ce5dfaf",
    "directories-2d9f2155f2", "directories-058be63100", "directories-03876deda4",
    "directories-3b1df6a3f9", "directories-c759cb59dd", "resume-bb3c8c49e2",
}  # fmt: skip


def _kept(file: Path) -> pytest.param:
    marks = pytest.mark.slow if {file.stem, file.stem.split("-")[0]} & LONG else ()
    return pytest.param(file, id=file.stem, marks=marks)


@pytest.fixture(scope="module")
def judge(tmp_path_factory: pytest.TempPathFactory) -> Judge:
    import_everything()
    return Judge(Starts(tmp_path_factory.mktemp("starts")))


@pytest.mark.parametrize("file", [*map(_kept, CORPUS)])
def test_an_input_that_once_failed(judge: Judge, file: Path) -> None:
    trial = Trial.read(file)
    outcome = judge.outcome(trial)
    assert outcome.fault(trial) == "", outcome


def test_an_input_is_read_as_it_was_written(tmp_path: Path) -> None:
    trial = Trial("csv", ("data=csv", "ä"), {"rig.csv": ("bytes", b"\xff\x00"), "x": ("cut", 0.5)}, "finished", 10)
    (tmp_path / "kept.json").write_text(trial.text(), encoding="utf-8")
    assert Trial.read(tmp_path / "kept.json") == trial


TRIAL = Trial("options", ("seed=-1",))
REFUSED = Outcome(2, "", "pinn-run: seed=-1: must be a whole number >= 0\n", 1.0, (), False)
DONE = Outcome(0, "verdict: sound\n/outputs\n", "", 1.0, ("outputs/fitness.csv",), False)


@pytest.mark.parametrize("outcome", [REFUSED, DONE, Outcome(3, "", "pinn-run: diverged\n", 1.0, ("run.json",), False)])
def test_one_line_or_a_verdict_is_no_fault(outcome: Outcome) -> None:
    assert outcome.fault(TRIAL) == ""


@pytest.mark.parametrize(
    ("outcome", "fault"),
    [
        (replace(REFUSED, executed=True), "code of the input was executed"),
        (replace(REFUSED, status=None), "still running"),
        (replace(REFUSED, status=-11), "exit status -11"),
        (replace(REFUSED, status=1), "exit status 1"),
        (replace(REFUSED, err="Traceback (most recent call last):\n"), "traceback"),
        (replace(REFUSED, err=""), "0 lines"),
        (replace(REFUSED, err=2 * REFUSED.err), "2 lines"),
        (replace(REFUSED, err=f"a warning\n{REFUSED.err}"), "not a line of pinn-run's: a warning"),
        (replace(REFUSED, err=f"pinn-run: {'x' * LONGEST_LINE}\n"), "a line of 1510 characters"),
        (replace(REFUSED, changes=("run/run.lock",)), "refused, but changed run/run.lock"),
        (replace(DONE, out="/outputs\n"), "no verdict"),
    ],
)
def test_a_fault_is_named(outcome: Outcome, fault: str) -> None:
    assert fault in outcome.fault(TRIAL)
