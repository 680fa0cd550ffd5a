"""What a tracker is told of a run, by a tracker that notes it; and that it can do the run no harm."""

import contextlib
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from pinn_cli.runs.resume import TRACKING as FILE
from pinn_cli.runs.resume import TrackingState
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.sweep.tracking.tracking import Followed, Outcome, TrackedRun, Tracker, Tracking, follow


class Notes(Tracker):
    """Notes what it is told."""

    def __init__(self, broken: bool = False) -> None:
        self.broken, self.iterations, self.told = broken, list[float](), list[tuple[object, ...]]()

    def row(self, row: Mapping[str, float]) -> None:
        self.iterations.append(row["iteration"])
        if self.broken:
            raise OSError("disk full")

    def end(self, status: str, reason: str, outcome: Outcome | None) -> None:
        self.told.append((status, reason, outcome))

    def delete(self) -> None:
        self.told.append(("deleted",))


class Noting(Tracking):
    name = "noting"

    def __init__(self) -> None:
        self.opened: list[Notes] = []
        self.keys: list[tuple[str, str]] = []

    def open(self, run: TrackedRun, key: str, before: str) -> Notes:
        state = TrackingState.read(run.directory)
        assert state is not None, "a kill from here on would leave an orphan"
        assert state.key == key
        self.opened.append(Notes())
        self.keys.append((key, before))
        return self.opened[-1]


@pytest.fixture
def job(tmp_path: Path) -> TrackedRun:
    return TrackedRun(tmp_path, "case/run", {"seed": "0"}, {"case": "case"}, "of these settings")


def row(iteration: int) -> dict[str, float]:
    return {"iteration": iteration, "seconds": 0.1, "loss_physics": 1.0 / iteration}


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (None, ("finished", "", None)),
        (DivergenceError("diverged at iteration 7"), ("failed", "diverged at iteration 7", None)),
        (RuntimeError("a defect"), ("failed", "a defect", None)),
        (KeyboardInterrupt("SIGINT"), ("interrupted", "SIGINT", None)),
        (InputError("seed", 2, "another"), ("deleted",)),
    ],
    ids=["done", "diverged", "a defect", "interrupted", "unusable"],
)
def test_how_it_ends(job: TrackedRun, error: BaseException | None, told: tuple[object, ...]) -> None:
    tracking = Noting()
    with contextlib.suppress(BaseException), follow(tracking, job, resuming=False) as tracked:
        tracked.row(row(1))
        if error is not None:
            raise error
    assert tracking.opened[0].told == [told]
    assert (job.directory / FILE).exists() == (told != ("deleted",))


def test_a_run_that_goes_on_is_the_same_tracked_run_and_another_one_takes_its_place(job: TrackedRun) -> None:
    tracking = Noting()
    starts = ((False, job), (True, job), (False, job), (True, replace(job, configuration="of others")))
    for resuming, each in starts:
        with contextlib.suppress(KeyboardInterrupt), follow(tracking, each, resuming) as tracked:
            for iteration in (1, 2, 2, 3):
                tracked.row(row(iteration))
            raise KeyboardInterrupt
    (first, none), (again, before), (second, replaced), (third, replaced_too) = tracking.keys
    assert first == again == before == replaced
    assert none == ""
    assert second == replaced_too
    assert len({first, second, third}) == 3
    assert [notes.iterations for notes in tracking.opened] == [[1, 2, 3]] * 4


def test_a_run_that_goes_on_is_not_forgotten_for_unusable_input(job: TrackedRun) -> None:
    tracking = Noting()
    for _ in range(2):
        with contextlib.suppress(InputError), follow(tracking, job, resuming=True):
            if len(tracking.opened) == 2:
                raise InputError("data.path", "record.csv", "a file", "it is gone")
    assert [told[0] for told in tracking.opened[1].told] == ["failed"]
    assert (job.directory / FILE).is_file()


KEPT = {"tracking": "noting", "configuration": "of these settings", "key": "a1", "ended": False}


DAMAGED = ("", "{", '{"tracking": "noting"}', json.dumps(KEPT | {"tracking": "x"}))


@pytest.mark.parametrize("content", DAMAGED)
def test_a_damaged_file_or_that_of_another_tracker_is_no_run_to_go_on_with(job: TrackedRun, content: str) -> None:
    (job.directory / FILE).write_text(content)
    tracking = Noting()
    with follow(tracking, job, resuming=True):
        pass
    assert [before for _, before in tracking.keys] == [""]


def test_a_tracker_that_breaks_is_complained_of_once_and_does_the_run_no_harm(job, caplog):
    notes = Notes(broken=True)
    tracked = Followed(notes, job.directory, TrackingState("noting", job.configuration, "a1"))
    for iteration in (1, 2, 3):
        tracked.row(row(iteration))
    tracked.end("finished")
    assert [record.message for record in caplog.records] == ["tracking=noting: disk full; the run goes on"]
    assert (notes.iterations, notes.told) == ([1], [])
    assert TrackingState.read(job.directory) is None  # not that it has everything


def test_nothing_is_tracked_by_none(job: TrackedRun) -> None:
    with follow(None, job, resuming=True) as tracked:
        tracked.row(row(1))
        tracked.results()
    assert list(job.directory.iterdir()) == []
