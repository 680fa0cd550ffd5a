"""A command that is refused, or waits, changes no byte of what lies where it would write; a user's files stay."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from calls import PinnRun
from interrupted_runs import ADAM, Steps, contents, without_figures
from sweeps import start

from pinn_cli.runs import claim as claims
from pinn_cli.runs.claim import LOG, Claim, RunLog, check_destination
from pinn_cli.settings.errors import InputError
from pinn_cli.training.gradient.training import GradientTraining

STOPPED = (*ADAM, "hydra.run.dir=run")


@pytest.fixture
def stopped(pinn_run: PinnRun, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A run that Ctrl-C stopped in its step 10, with checkpoints."""
    without_figures(monkeypatch)
    steps = Steps(monkeypatch)
    steps.signal_at(10, signal.SIGINT)
    assert pinn_run(*STOPPED).status == 130
    steps.undisturbed()
    return tmp_path / "run"


REFUSED = {
    "a value": ["seed=-3"],
    "a value, going on": ["seed=-3", "resume=auto"],
    "no data": ["data=csv", "data.path=nowhere.csv"],
    "a structure": ["system.m=-1"],
    "found by the training": ["network=fourier", "scheme=bayesian", "training=adam"],
    "found by the network": ["training.collocation_points=3"],
    "composition": ["sytem.m=1"],
    "a setting of Hydra's": ["hydra.run.dir=run/.hydra/config.yaml"],
}


def test_a_refused_command_leaves_another_run_as_it_was_though_it_had_begun(
    pinn_run: PinnRun, stopped: Path, monkeypatch
) -> None:
    before = contents(stopped)
    for case, given in REFUSED.items():
        outcome = pinn_run(*STOPPED, *given)
        assert (outcome.status, outcome.err.count(": must be ")) == (2, 1), (case, outcome.err)
        assert contents(stopped) == before, case

    def refuse(*args: object) -> None:
        assert not (stopped / "checkpoint.pt").exists()
        assert "seed: 5" in (stopped / ".hydra" / "config.yaml").read_text()
        assert "seed: 5" not in before[".hydra/config.yaml"].decode()
        raise InputError("network", "x", "another")

    monkeypatch.setattr(GradientTraining, "solve", refuse)
    assert pinn_run(*STOPPED, "seed=5").status == 2
    assert contents(stopped) == before


@pytest.mark.slow
def test_a_command_that_waits_changes_nothing(stopped: Path, tmp_path: Path) -> None:
    """With other settings, and killed while it waits."""
    hold = "import sys, time; from pathlib import Path; from pinn_cli.runs.claim import held\n"
    hold += "with held(Path('run')): print('in', flush=True); time.sleep(300)"
    owner = subprocess.Popen([sys.executable, "-c", hold], stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    assert owner.stdout.readline() == "in\n"
    before = contents(stopped)
    waiting = start(tmp_path, *STOPPED, "seed=9")
    assert "waiting for another process" in waiting.stderr.readline()
    time.sleep(0.3)
    assert contents(stopped) == before
    waiting.send_signal(signal.SIGTERM)
    assert waiting.wait(timeout=10) == 143
    assert contents(stopped) == before
    owner.kill()
    owner.wait()


@pytest.mark.slow
def test_a_refused_sweep_leaves_another_one_as_it_was(pinn_run: PinnRun, tmp_path: Path) -> None:
    sweep = ("--multirun", *ADAM, "training.iterations=1", "hydra.sweep.dir=sweep")
    assert pinn_run(*sweep, "seed=0,1").status == 0
    before = contents(tmp_path / "sweep")
    places = sorted(tmp_path.rglob("*"))
    for given in (["seed=0,1", "system.m=-1"], ["seed=2,3", "system.m=-1"], ["seed=0,1", "system=linear,dufing"]):
        assert pinn_run(*sweep, *given).status == 2
        assert contents(tmp_path / "sweep") == before
        assert sorted(tmp_path.rglob("*")) == places
    # Of a sweep that is refused in part the rest is made, and the refused jobs are rows.
    extended = pinn_run(*sweep, "seed=5", "system.m=-1,1")
    assert extended.status == 2
    assert "3 finished, 1 failed" in extended.out


def test_what_is_logged_before_the_directory_is_taken_is_not_lost(tmp_path: Path) -> None:
    log = RunLog()
    log.attach()
    claims.log.warning("early")
    log.open(tmp_path / LOG)
    claims.log.warning("late")
    log.close()
    claims.log.warning("too late")
    lines = (tmp_path / LOG).read_text().splitlines()
    assert [line.rpartition("]")[2] for line in lines] == [" early", " late"]


def test_a_claim_that_is_killed_leaves_a_directory_that_can_be_taken(tmp_path: Path) -> None:
    """What was set aside looks like a file half-written, and goes with those."""
    (tmp_path / "run.json").write_text("{}")
    (tmp_path / ".hydra").mkdir()
    (tmp_path / ".hydra" / "hydra.yaml").write_text("pinn_cli")
    child = os.fork()
    if child == 0:
        Claim(tmp_path, "hydra.run.dir", {}).take(["run.json"])
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    assert not (tmp_path / "run.json").exists()
    claim = Claim(tmp_path, "hydra.run.dir", {})
    claim.take()
    claim.release()
    assert {entry.name for entry in tmp_path.iterdir()} == {".hydra", LOG}


QUICK = (*ADAM, "training.iterations=1", "figures=false")
SWEEP = ("--multirun", *QUICK, "seed=0,1")


@pytest.fixture
def mine(tmp_path: Path) -> dict[str, bytes]:
    """Files of a user's, with names that a run has too."""
    (tmp_path / "deep").mkdir()
    for name in ("history.csv", "parameters.csv", "rig.csv", ".notes.12.partial.csv", "deep/.mine.7.partial.txt"):
        (tmp_path / name).write_text("mine")
    return contents(tmp_path)


@pytest.mark.parametrize(
    "given",
    [
        (*QUICK, "hydra.run.dir=."),
        (*QUICK, "hydra.run.dir="),
        (*QUICK, "hydra.run.dir=''"),
        (*QUICK, "hydra.run.dir=null"),
        (*QUICK, "hydra.run.dir=deep/.."),
        (*SWEEP, "hydra.sweep.dir=."),
        (*SWEEP, "hydra.sweep.dir="),
        (*SWEEP, "hydra.sweep.dir=deep", "hydra.sweep.subdir=.."),
    ],
)
def test_files_of_a_user_are_not_touched(pinn_run: PinnRun, tmp_path: Path, mine, given: tuple[str, ...]) -> None:
    pinn_run(*given).refused("dir=", "pinn-run: hydra.")
    assert contents(tmp_path) == mine
    assert {entry.name for entry in tmp_path.iterdir() if entry.is_dir()} == {"deep"}


def test_an_empty_directory_and_an_earlier_run_are_taken(pinn_run: PinnRun, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for _ in range(2):
        assert pinn_run(*QUICK, "hydra.run.dir=empty").status == 0
    (tmp_path / "empty" / "notes.txt").write_text("mine")
    assert pinn_run(*QUICK, "hydra.run.dir=empty").status == 0
    assert (tmp_path / "empty" / "notes.txt").read_text() == "mine"


def test_files_of_another_program_and_what_is_no_file_are_refused(tmp_path: Path) -> None:
    (tmp_path / ".hydra").mkdir()
    (tmp_path / ".hydra" / "hydra.yaml").write_text("hydra: {job: {name: other}}")
    (tmp_path / "checkpoint.pt").write_text("mine")
    with pytest.raises(InputError, match=r"hydra\.run\.dir=.*pinn-run made; files of yours"):
        check_destination(tmp_path, "hydra.run.dir")
    (tmp_path / "checkpoint.pt").unlink()
    (tmp_path / ".hydra" / "hydra.yaml").write_text("pinn_cli")
    (tmp_path / "notes").mkdir()
    check_destination(tmp_path, "hydra.run.dir")
    makers = {
        "checkpoint.pt": lambda place: place.mkdir(),
        "run.json": os.mkfifo,
        "pinn-run.log": lambda place: place.symlink_to("elsewhere"),
        "figures": lambda place: place.touch(),
    }
    for name, make in makers.items():
        make(tmp_path / name)
        with pytest.raises(InputError, match=f"{name} there is no"):
            check_destination(tmp_path, "hydra.run.dir")
        (tmp_path / name).rmdir() if name == "checkpoint.pt" else (tmp_path / name).unlink()
