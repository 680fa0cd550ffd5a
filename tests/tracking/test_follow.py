"""What a tracker is told of a run, by a tracker that notes it; and that it can do the run no harm."""

from __future__ import annotations

import contextlib
import json
import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from calls import PinnRun
from interrupted_runs import ADAM, Steps, assert_same_numbers, without_figures

from pinn_cli.runs.tracking_state import FILE, TrackingState
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.tracking.base import TrackedRun, Tracker, Tracking, require
from pinn_cli.tracking.follow import Followed, follow
from pinn_cli.tracking.none import NoTracking
from pinn_cli.tracking.outcome import Outcome


class Notes(Tracker):
    """Notes what it is told."""

    def __init__(self, broken: bool = False) -> None:
        self.broken, self.told = broken, list[tuple[object, ...]]()

    def rows(self, rows: Sequence[Mapping[str, float]]) -> None:
        if self.broken:
            raise OSError("disk full")
        self.told.append(("rows", [row["iteration"] for row in rows]))

    def results(self, outcome: Outcome) -> None:
        self.told.append(("results", outcome))

    def end(self, status: str, reason: str) -> None:
        self.told.append(("end", status, reason))

    def delete(self) -> None:
        self.told.append(("delete",))


class Noting(Tracking):
    name = "noting"

    def __init__(self) -> None:
        self.opened: list[Notes] = []
        self.known: list[bool] = []
        self.keys: list[str] = []
        self.abandoned: list[str] = []

    def open(self, job: TrackedRun, state: TrackingState, known: bool) -> Notes:
        assert TrackingState.read(job.directory) == state, "a kill from here on would leave an orphan"
        self.opened.append(Notes())
        self.known.append(known)
        self.keys.append(state.key)
        return self.opened[-1]

    def abandon(self, key: str) -> None:
        self.abandoned.append(key)


@pytest.fixture
def job(tmp_path: Path) -> TrackedRun:
    return TrackedRun(tmp_path, "case/run", {"seed": "0"}, {"case": "case"}, "of these settings")


def noted(job: TrackedRun, notes: Notes, clock: Callable[[], float]) -> Followed:
    return Followed(notes, job.directory, TrackingState("noting", job.configuration, "a1"), clock)


def row(iteration: int) -> dict[str, float]:
    return {"iteration": iteration, "seconds": 0.1, "loss_physics": 1.0 / iteration}


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (None, ("end", "finished", "")),
        (DivergenceError("diverged at iteration 7"), ("end", "failed", "diverged at iteration 7")),
        (RuntimeError("a defect"), ("end", "failed", "a defect")),
        (KeyboardInterrupt("SIGINT"), ("end", "interrupted", "SIGINT")),
        (InputError("seed", 2, "another"), ("delete",)),
    ],
    ids=["done", "diverged", "a defect", "interrupted", "unusable"],
)
def test_how_it_ends(job: TrackedRun, error: BaseException | None, told: tuple[object, ...]) -> None:
    tracking = Noting()
    with contextlib.suppress(BaseException), follow(tracking, job, resuming=False) as tracked:
        tracked.row(row(1))
        if error is not None:
            raise error
    assert tracking.opened[0].told[-1] == told
    assert (job.directory / FILE).exists() == (told != ("delete",))


def test_a_run_that_goes_on_is_the_same_tracked_run_and_no_row_comes_twice(job: TrackedRun) -> None:
    tracking = Noting()
    with contextlib.suppress(KeyboardInterrupt), follow(tracking, job, resuming=False) as tracked:
        for iteration in (1, 2, 3):
            tracked.row(row(iteration))
        raise KeyboardInterrupt
    with follow(tracking, job, resuming=True) as tracked:
        for iteration in (2, 3, 4):  # from a checkpoint that is older than what was told
            tracked.row(row(iteration))
    with follow(tracking, job, resuming=False):
        pass
    assert tracking.known == [False, True, False]
    assert tracking.keys[0] == tracking.keys[1] != tracking.keys[2]
    assert tracking.abandoned == tracking.keys[:1]
    assert tracking.opened[0].told[0] == ("rows", [1, 2, 3])
    assert tracking.opened[1].told[0] == ("rows", [4])


def test_a_run_of_other_settings_is_another_tracked_run(job: TrackedRun) -> None:
    tracking = Noting()
    with follow(tracking, job, resuming=True) as tracked:
        tracked.row(row(1))
    with follow(tracking, replace(job, configuration="of others"), resuming=True) as tracked:
        tracked.row(row(1))
    assert tracking.known == [False, False]
    assert tracking.abandoned == tracking.keys[:1]
    assert tracking.opened[1].told[0] == ("rows", [1])


def test_a_run_that_goes_on_is_not_forgotten_for_unusable_input(job: TrackedRun) -> None:
    tracking = Noting()
    for _ in range(2):
        with contextlib.suppress(InputError), follow(tracking, job, resuming=True):
            if len(tracking.opened) == 2:
                raise InputError("data.path", "record.csv", "a file", "it is gone")
    (end,) = tracking.opened[1].told
    assert end[:2] == ("end", "failed")
    assert (job.directory / FILE).is_file()


def test_a_tracker_of_another_kind_does_not_go_on_with_it(job: TrackedRun) -> None:
    TrackingState("mlflow", job.configuration, "a1", 5.0).write(job.directory)
    tracking = Noting()
    with follow(tracking, job, resuming=True) as tracked:
        tracked.row(row(1))
    assert tracking.known == [False]
    assert tracking.abandoned == []
    assert tracking.opened[0].told[0] == ("rows", [1])


GOOD = {"tracking": "noting", "configuration": "of these settings", "key": "a1", "logged": 5, "ended": False}


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[]",
        "{",
        '{"tracking": "noting"}',
        *(json.dumps(GOOD | bad) for bad in ({"logged": "x"}, {"key": "' or 1"})),
    ],
)
def test_a_damaged_file_is_no_run_to_go_on_with(job: TrackedRun, content: str) -> None:
    (job.directory / FILE).write_text(content)
    tracking = Noting()
    with follow(tracking, job, resuming=True):
        pass
    assert tracking.known == [False]


def test_a_tracker_that_breaks_is_told_of_once_and_gets_its_rows_when_it_is_back(
    job: TrackedRun, caplog: pytest.LogCaptureFixture
) -> None:
    time = iter(range(0, 10_000, 100))
    notes = Notes(broken=True)
    tracked = noted(job, notes, lambda: float(next(time)))
    for iteration in (1, 2, 3):
        tracked.row(row(iteration))
    assert [record.message for record in caplog.records] == ["tracking=noting: disk full; the run goes on"]
    notes.broken = False
    tracked.row(row(4))
    assert notes.told == [("rows", [1, 2, 3, 4])]


def test_rows_come_in_batches(job: TrackedRun) -> None:
    now = [0.0]
    notes = Notes()
    tracked = noted(job, notes, lambda: now[0])
    for iteration in range(1, 8):
        now[0] += 1.0
        tracked.row(row(iteration))
    assert notes.told == [("rows", [1, 2, 3, 4, 5])]


def test_nothing_is_tracked_by_none(job: TrackedRun) -> None:
    with follow(NoTracking(), job, resuming=True) as tracked:
        tracked.row(row(1))
        tracked.results()
    assert list(job.directory.iterdir()) == []


def test_a_package_that_is_missing_is_named() -> None:
    with pytest.raises(InputError, match=r"tracking=mlflow: must be none.*pip install 'pinn-cli\[mlflow\]'"):
        require("a_package_that_nobody_has", "mlflow")


def test_a_run_is_followed_from_start_to_end(
    pinn_run: PinnRun, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Interrupted and gone on with: one tracked run, every row of the history once, the numbers of an untracked run."""
    without_figures(monkeypatch)
    tracking, steps = Noting(), Steps(monkeypatch)
    monkeypatch.setattr(NoTracking, "name", "noting")
    monkeypatch.setattr(NoTracking, "open", lambda self, *given: tracking.open(*given))
    steps.signal_at(10, signal.SIGINT)
    assert pinn_run(*ADAM, "hydra.run.dir=run").status == 130
    steps.undisturbed()
    assert pinn_run("resume=run").status == 0
    monkeypatch.undo()
    without_figures(monkeypatch)
    monkeypatch.chdir(tmp_path)
    assert pinn_run(*ADAM, "hydra.run.dir=plain").status == 0
    assert_same_numbers(tmp_path / "run", tmp_path / "plain")
    assert tracking.known == [False, True]
    told = [entry for notes in tracking.opened for entry in notes.told]
    iterations = [iteration for kind, *rest in told if kind == "rows" for iteration in rest[0]]  # type: ignore[attr-defined]
    assert iterations == pd.read_csv(tmp_path / "run" / "history.csv")["iteration"].tolist()
    assert [entry[1] for entry in told if entry[0] == "end"] == ["interrupted", "finished"]
    (outcome,) = (entry[1] for entry in told if entry[0] == "results")
    assert isinstance(outcome, Outcome)
    fitness = pd.read_csv(tmp_path / "run" / "fitness.csv").set_index(["group", "quantity"])["fitness_percent"]
    assert outcome.metrics["fitness_percent/velocity"] == fitness["all", "velocity"]
    assert {"error_percent/k_1", "seconds/total", "training/iterations"} <= set(outcome.metrics)
    assert "fitness.csv" in {file.name for file in outcome.files}
    assert not {"checkpoint.pt", "run.lock", FILE} & {file.name for file in outcome.files}


def test_a_tracker_that_fails_is_asked_less_and_less_often_until_it_is_back(job: TrackedRun) -> None:
    notes, now, asked = Notes(broken=True), [0.0], []
    tell = notes.rows
    notes.rows = lambda rows: (asked.append(now[0]), tell(rows))  # type: ignore[method-assign,assignment,func-returns-value]
    tracked = noted(job, notes, lambda: now[0])
    for second in range(100):
        now[0], notes.broken = float(second), second < 80
        tracked.row(row(second + 1))
    assert asked == [5.0, 15.0, 35.0, 75.0]
    for second in range(100, 200):
        now[0] = float(second)
        tracked.row(row(second + 1))
    assert asked[4:7] == [155.0, 160.0, 165.0]
