"""Checkpoints: written whole, sealed, the last two kept, of one run only; and a loop that goes on from them."""

import logging
import os
import random
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch

from pinn_cli.runs.checkpoint import (
    LAST,
    PREVIOUS,
    CheckpointFiles,
    Checkpoints,
    DamagedCheckpointError,
    OtherRunError,
    sealed,
    unsealed,
)
from pinn_cli.runs.identity import Identity
from pinn_cli.runs.writing import tidy
from pinn_cli.settings.errors import InputError
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.history import Stepwise, train

IDENTITY = Identity({"noise.snr_db": "50"}, {"torch": "2.4"})


class RandomWalk(Stepwise):
    """Adds a number from each generator, and breaks or is stopped where it is told to."""

    def __init__(self, steps: int = 10, at: int | None = None, happens=lambda: None) -> None:
        self.steps, self.at, self.happens = steps, at, happens
        self.sum, self.done, self.taken = torch.zeros(3, dtype=torch.float64), 0, 0

    def step(self) -> bool:
        if self.done == self.steps:
            return False
        if self.done == self.at:
            self.happens()
        drawn = [float(torch.rand(())), float(np.random.rand()), random.random()]  # noqa: NPY002
        self.sum += torch.tensor(drawn, dtype=torch.float64)
        self.done, self.taken = self.done + 1, self.taken + 1
        return True

    def state_dict(self):
        return {"sum": self.sum, "done": self.done, "more": [None, "text", (1, 2.5, {"deep": True})]}

    def load_state_dict(self, state) -> None:
        self.sum, self.done = state["sum"].clone(), state["done"]


class Killed(BaseException):
    """Stands in for SIGKILL: nothing is done about it."""


def kill() -> None:
    raise Killed


def checkpoints(directory: Path, every_s: float | None = 1.0, identity: Identity = IDENTITY) -> Checkpoints:
    """A second passes whenever the clock is read."""
    seconds = iter(range(1_000_000))
    return Checkpoints(directory, identity, every_s, clock=lambda: float(next(seconds)))


def seed() -> None:
    torch.manual_seed(1)
    np.random.seed(1)  # noqa: NPY002
    random.seed(1)


def walk(walker: RandomWalk, kept: Checkpoints | None) -> RandomWalk:
    seed()
    train(walker, RunContext(checkpoints=kept))
    return walker


@pytest.fixture
def undisturbed() -> RandomWalk:
    return walk(RandomWalk(), None)


def content(file: Path):
    return torch.load(file, weights_only=True)


def test_sealed_content_comes_back_and_torch_alone_reads_it(tmp_path):
    given = {"a": torch.arange(5.0), "b": [1, None, "x", (2.5, {"c": float("inf")})], "d": torch.zeros(0, dtype=int)}
    data = sealed(given)
    (tmp_path / "file.pt").write_bytes(data)
    for back in (unsealed(data), content(tmp_path / "file.pt")):
        assert torch.equal(back["a"], given["a"])
        assert back["b"] == given["b"]
        assert back["d"].dtype == torch.int64


class Evil:
    def __reduce__(self):
        return os.mkdir, ("executed",)


def reseal(data: bytes) -> bytes:
    from pinn_cli.runs.checkpoint import _seal

    return data[:-64] + _seal(data[:-66])


HARM = {
    "empty": lambda data: b"",
    "cut short": lambda data: data[: len(data) // 2],
    "one byte short": lambda data: data[:-1],
    "one bit": lambda data: data[:300] + bytes([data[300] ^ 1]) + data[301:],
    "another seal": lambda data: data[:-1] + bytes([data[-1] ^ 1]),
    "not an archive": lambda data: b"x" * 10_000,
    "code": lambda data: sealed({"state": Evil()}),
    "forged and broken": lambda data: reseal(data[:200] + b"\0" * 100 + data[300:]),
    "no mapping": lambda data: sealed([1, 2]),
}


@pytest.mark.parametrize("harm", HARM.values(), ids=HARM.keys())
def test_a_damaged_file_is_told_in_one_line_and_the_previous_is_used(harm, tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    files = CheckpointFiles(tmp_path)
    good, last = sealed({"number": 1}), sealed({"number": 2})
    files.write(good)
    files.write(last)
    (tmp_path / LAST).write_bytes(harm(last))
    again = CheckpointFiles(tmp_path)
    with caplog.at_level(logging.WARNING, "pinn_cli"):
        assert again.read() == {"number": 1}
    (message,) = (record.getMessage() for record in caplog.records)
    assert str(tmp_path / LAST) in message
    assert "\n" not in message
    assert not (tmp_path / "executed").exists()
    # The damaged one does not take the good one's place.
    again.write(sealed({"number": 3}))
    assert (content(tmp_path / LAST), content(tmp_path / PREVIOUS)) == ({"number": 3}, {"number": 1})
    with pytest.raises(DamagedCheckpointError):
        unsealed(harm(last))


@pytest.mark.parametrize("moment", ["before any name is changed", "between the two"])
def test_a_kill_while_writing_leaves_a_good_one(moment, tmp_path, monkeypatch):
    files = CheckpointFiles(tmp_path)
    for number in range(2):
        files.write(sealed({"number": number}))
    replace, calls = os.replace, []

    def replace_or_die(source, target):
        calls.append(target)
        if moment == "before any name is changed" or len(calls) == 2:
            raise Killed
        replace(source, target)

    monkeypatch.setattr(os, "replace", replace_or_die)
    with pytest.raises(Killed):
        files.write(sealed({"number": 2}))
    monkeypatch.undo()
    assert CheckpointFiles(tmp_path).read() == {"number": 1}


def test_what_a_killed_process_left_half_written_is_removed(tmp_path):
    (tmp_path / "figures").mkdir()
    for name in (".checkpoint.123.partial.pt", ".fitness.7.partial.csv", "figures/.response.7.partial.png"):
        (tmp_path / name).write_text("half")
    (tmp_path / "deep").mkdir()
    for name in ("mine.txt", ".mine.partial.txt", "deep/.mine.7.partial.txt"):
        (tmp_path / name).write_text("half")
    tidy(tmp_path)
    assert sorted(file.name for file in tmp_path.rglob("*")) == [
        ".mine.7.partial.txt", ".mine.partial.txt", "deep", "figures", "mine.txt",
    ]  # fmt: skip


@pytest.mark.parametrize("at", range(10))
def test_a_killed_training_goes_on_as_if_never_stopped(at, tmp_path, undisturbed):
    with pytest.raises(Killed):
        walk(RandomWalk(at=at, happens=kill), checkpoints(tmp_path))
    again = checkpoints(tmp_path)
    assert again.take_up() == (at > 0)
    resumed = walk(RandomWalk(), again)
    assert torch.equal(resumed.sum, undisturbed.sum)
    assert (resumed.done, resumed.taken) == (10, min(10, 11 - at))


def test_a_training_that_ended_does_no_further_step(tmp_path, undisturbed):
    walk(RandomWalk(), checkpoints(tmp_path, every_s=None))
    again = checkpoints(tmp_path)
    assert again.take_up()
    resumed = walk(RandomWalk(), again)
    assert torch.equal(resumed.sum, undisturbed.sum)
    assert resumed.taken == 0
    after = torch.rand(())
    walk(RandomWalk(), None)
    assert torch.rand(()) == after  # what torch's generator gives next where nothing was interrupted


@pytest.mark.parametrize("killed_in", [0, 1])
def test_several_trainings_in_one_run(killed_in, tmp_path):
    def both(kept, *killed):
        seed()
        walkers = [RandomWalk(4, at=2 if number in killed else None, happens=kill) for number in range(2)]
        for walker in walkers:
            train(walker, RunContext(checkpoints=kept))
        return [walker.sum for walker in walkers]

    expected = both(None)
    with pytest.raises(Killed):
        both(checkpoints(tmp_path), killed_in)
    again = checkpoints(tmp_path)
    again.take_up()
    assert all(map(torch.equal, both(again), expected))


GOOD_STATE = {"sum": torch.zeros(3), "done": 1}


@pytest.mark.parametrize(
    "trainings",
    [[{"ended": False, "state": {"sum": 1}}], [{"ended": False}], [3], [{"ended": False, "state": GOOD_STATE}]],
    ids=["another state", "no state", "a number", "no generators"],
)
def test_a_forged_state_is_an_error_of_the_input(trainings, tmp_path):
    kept = checkpoints(tmp_path)
    kept.write(sealed({"format": 1, "identity": asdict(IDENTITY), "trainings": trainings, "random": {}}))
    kept.take_up()
    with pytest.raises(InputError, match="resume=.*checkpoint.pt: must be a checkpoint of this training"):
        walk(RandomWalk(), kept)
    for other in ({}, {"format": 1}, {"format": 1, "identity": 3}):  # no checkpoint, or another run's
        checkpoints(tmp_path).write(sealed(other))
        with pytest.raises(OtherRunError):
            checkpoints(tmp_path).take_up()
