"""Two processes that start the same thing at the same time, on locks that are slow: each ends, and nothing is lost."""

import errno
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd
import pytest
from calls import SMALL
from filelock import FileLock
from sweeps import mlflow_runs

from pinn_cli.runs import claim
from pinn_cli.runs.claim import LOCK, SWEEP_LOCK, held
from pinn_cli.runs.reading import small_text

HOLD = """
import sys, time
from pathlib import Path
from pinn_cli.runs.claim import held
with held(Path(sys.argv[1]), sys.argv[2]):
    print("in", flush=True)
    time.sleep(60)
"""
# The command on a network whose every answer about a lock takes its time.
SLOW_LOCKS = """
import sys, time
from filelock import FileLock
acquire = FileLock._acquire
def late(lock):
    time.sleep(0.4)
    acquire(lock)
    time.sleep(0.4)
FileLock._acquire = late
sys.argv[0] = "pinn-run"
from pinn_cli.main import main
main()
"""
QUICK = (*SMALL, "figures=false")
SEARCH = (
    "--multirun", *QUICK, "hydra/sweeper=search", "validation=heldout", "scheme.unobserved_fraction=0.3",
    "network.knots_per_period=interval(1.0,5.0)", "hydra.sweeper.n_trials=3",
)  # fmt: skip


@pytest.fixture
def other() -> Iterator[Callable[[Path, str], subprocess.Popen[str]]]:
    """Has another process be in a directory."""
    begun: list[subprocess.Popen[str]] = []

    def enter(directory: Path, name: str) -> subprocess.Popen[str]:
        directory.mkdir(exist_ok=True)
        command = [sys.executable, "-c", HOLD, str(directory), name]
        begun.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        assert begun[-1].stdout.readline() == "in\n"
        return begun[-1]

    yield enter
    for process in begun:
        process.kill()
        process.wait()


def test_nothing_is_left_behind(tmp_path: Path) -> None:
    with held(tmp_path):
        assert f'"pid": {os.getpid()}' in (tmp_path / LOCK).read_text()
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="away"), held(tmp_path):
        raise ValueError("away")
    assert not list(tmp_path.iterdir())


def test_the_second_waits_until_the_first_is_killed(other, tmp_path: Path, monkeypatch, caplog) -> None:
    first = other(tmp_path, LOCK)
    monkeypatch.setattr(claim, "EVERY_S", 0.02)
    threading.Timer(0.3, first.send_signal, [signal.SIGKILL]).start()
    start = time.perf_counter()
    with held(tmp_path):
        assert time.perf_counter() - start > 0.25
        assert first.wait() == -signal.SIGKILL
    (told,) = caplog.messages
    assert told.startswith(f"waiting for another process to leave {tmp_path}: ")
    assert f'"pid": {first.pid}' in told


def test_many_come_in_one_by_one(tmp_path: Path, monkeypatch) -> None:
    """Also across the moment at which the one before removes the file."""
    monkeypatch.setattr(claim, "EVERY_S", 1e-4)
    inside: list[int] = []
    most: list[int] = []

    def come_in(number: int) -> None:
        for _ in range(30):
            with held(tmp_path):
                inside.append(number)
                most.append(len(inside))
                time.sleep(1e-4)
                inside.remove(number)

    threads = [threading.Thread(target=come_in, args=[number]) for number in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (len(most), max(most)) == (180, 1)
    assert not list(tmp_path.iterdir())


def test_a_file_system_without_locks_is_told_of(tmp_path: Path, monkeypatch, caplog) -> None:
    def refuse(lock: FileLock, **_: object) -> None:
        raise OSError(errno.ENOLCK, "no locks available")

    monkeypatch.setattr(FileLock, "acquire", refuse)
    with held(tmp_path):
        assert not list(tmp_path.iterdir())
    assert "file system without locks" in caplog.text


@pytest.mark.parametrize(
    ("name", "given"),
    [(LOCK, ("hydra.run.dir=place",)), (SWEEP_LOCK, ("--multirun", "seed=0,1", "hydra.sweep.dir=place"))],
    ids=["a run", "a sweep"],
)
def test_a_command_waits_for_the_one_in_its_directory(other, pinn_run, tmp_path, monkeypatch, name, given):
    place = tmp_path / "place"
    first = other(place, name)
    monkeypatch.setattr(claim, "EVERY_S", 0.02)

    def left(file: Path) -> str:
        if file.name != name:
            return small_text(file)
        first.terminate()
        return ""

    monkeypatch.setattr(claim, "small_text", left)  # who is in there is asked once, when it has to wait
    seen: list[bool] = []
    done = pinn_run(*given, task=lambda config: seen.append((place / name).is_file()))
    assert (done.status, first.wait()) == (0, -signal.SIGTERM), done.err
    assert set(seen) == {True}
    assert "waiting for another process to leave" in done.err
    assert not (place / name).exists()


@pytest.mark.parametrize("name", [LOCK, SWEEP_LOCK])
def test_a_refused_command_takes_no_directory_from_another(other, tmp_path: Path, name: str) -> None:
    """Both found it missing, and made it."""
    place = tmp_path / "outputs" / "place"
    claim.note_new(place)
    place.parent.mkdir()
    first = other(place, name)
    claim.discard()
    assert (place / name).is_file()
    first.kill()
    first.wait()
    claim.discard()
    assert not place.parent.exists()


def test_who_waits_for_a_directory_that_goes_makes_it_anew(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(claim, "EVERY_S", 0.02)
    place = tmp_path / "place"
    place.mkdir()
    claim.note_new(tmp_path / "x")
    entered = threading.Event()

    def second() -> None:
        with held(place):
            assert (place / LOCK).is_file()
            entered.set()

    waiting = threading.Thread(target=second)
    with held(place):
        waiting.start()
        time.sleep(0.1)
        (place / LOCK).unlink()
        place.rmdir()
    waiting.join(timeout=10)
    assert entered.is_set()


def both(folder: Path, *commands: tuple[str, ...]) -> list[str]:
    """Start commands at once on slow locks; what each says on standard error."""
    begun = [
        subprocess.Popen(
            [sys.executable, "-c", SLOW_LOCKS, *command],
            cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for command in commands
    ]  # fmt: skip
    said = [process.communicate(timeout=300)[1] for process in begun]
    assert [process.returncode for process in begun] == [0] * len(commands), said
    assert not any("Traceback" in text for text in said), said
    return said


@pytest.mark.slow
def test_two_of_the_same_run(tmp_path: Path) -> None:
    said = both(tmp_path, *[(*QUICK, "hydra.run.dir=run", "resume=auto")] * 2)
    assert (tmp_path / "run" / "pinn-run.log").read_text().count("estimate:") == 1
    assert sum("waiting for another process to leave" in text for text in said) <= 1
    assert not list(tmp_path.rglob("*.lock"))


@pytest.mark.slow
def test_two_of_the_same_sweep(tmp_path: Path) -> None:
    said = both(tmp_path, *[("--multirun", *QUICK, "seed=0,1,2", "hydra.sweep.dir=sweep")] * 2)
    assert sorted(text.count("waiting for another process") for text in said) == [0, 1]
    assert sum("3 of 3 jobs are finished already" in text for text in said) == 1
    assert list(pd.read_csv(tmp_path / "sweep" / "jobs.csv")["status"]) == ["finished"] * 3
    assert not list(tmp_path.rglob("*.lock"))


@pytest.mark.slow
def test_two_of_the_same_search(tmp_path: Path) -> None:
    pytest.importorskip("optuna", reason="the extra optuna is not installed")
    both(tmp_path, *[(*SEARCH, "hydra.sweep.dir=found")] * 2)
    trials = pd.read_csv(tmp_path / "found" / "search.csv")
    assert trials["trial"].tolist() == [0, 1, 2]
    assert trials["directory"].nunique() == 3


@pytest.mark.slow
def test_two_with_the_same_stores(tmp_path: Path) -> None:
    """MLflow's database is made by whoever comes first; TensorBoard's folder is that of both."""
    pytest.importorskip("mlflow", reason="the extra mlflow is not installed")
    pytest.importorskip("tensorboard", reason="the extra tensorboard is not installed")
    said = both(tmp_path, *[(*QUICK, f"seed={seed}", "tracking=mlflow", "tracking.files=false") for seed in range(2)])
    assert not any("the run goes on" in text for text in said), said
    runs = mlflow_runs(tmp_path / "outputs" / "mlflow.db")
    assert sorted((run.data.params["seed"], run.info.status) for run in runs) == [(s, "FINISHED") for s in "01"]
    shared = ("tracking=tensorboard", "tracking.directory=events")
    both(tmp_path, *[(*QUICK, f"seed={seed}", *shared, f"hydra.run.dir={seed}/run") for seed in range(2)])
    keys = {file.name.rpartition(".")[2] for file in (tmp_path / "events").rglob("events.out.tfevents.*")}
    assert len(keys) == 2
