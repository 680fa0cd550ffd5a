"""Every input that ever failed is refused in one line, or has a sound result, and the judge sees what must not be."""

from dataclasses import replace
from pathlib import Path

import pytest
from fuzz.judge import LONGEST_LINE, Judge, Outcome, import_everything
from fuzz.starts import Starts
from fuzz.trial import Trial

CORPUS = sorted((Path(__file__).parent / "corpus").glob("*.json"))
# One of each family that does not take a whole estimate goes with every change.
QUICK = {
    "bombs-b74dd02f86", "csv-c21cf8a4e0", "disk-64e1592469", "launchers-1da9aacd41", "options-0a0bd1bfc4",
    "terminal-4838b0a1da", "yaml-14b0948da4",
}  # fmt: skip


def _kept(file: Path) -> pytest.param:
    return pytest.param(file, id=file.stem, marks=() if file.stem in QUICK else pytest.mark.slow)


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
