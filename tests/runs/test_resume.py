"""A run that is interrupted or killed goes on with its own configuration and ends with the same numbers."""

import os
import re
import signal
from pathlib import Path

import pandas as pd
import pytest
import torch
from calls import SMALL, Compose, PinnRun
from interrupted_runs import ADAM, Steps, assert_same_numbers, contents, in_a_child, run_in_a_child, without_figures
from omegaconf import DictConfig, OmegaConf

from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.help import option_names
from pinn_cli.record.simulated import Simulated
from pinn_cli.report import netcdf
from pinn_cli.runs import identity
from pinn_cli.runs.identity import Identity
from pinn_cli.settings.errors import InputError
from pinn_cli.training.evidence import Evidence
from pinn_cli.training.function_space.equations import NetworkSystem

HYDRAS = {".hydra", "pinn-run.log"}
CHECKPOINTS = {"checkpoint.pt", "checkpoint.previous.pt"}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    without_figures(monkeypatch)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same run, undisturbed."""
    return run_in_a_child(tmp_path_factory.mktemp("undisturbed") / "whole", *ADAM)


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> Steps:
    return Steps(monkeypatch)


@pytest.fixture
def interrupted(pinn_run: PinnRun, steps: Steps, tmp_path: Path) -> Path:
    """A run that Ctrl-C stopped in step 10."""
    steps.signal_at(10, signal.SIGINT)
    assert pinn_run(*ADAM, "hydra.run.dir=run").status == 130
    steps.undisturbed()
    return tmp_path / "run"


@pytest.mark.parametrize(
    ("number", "status", "how"),
    [(signal.SIGINT, 130, ("resume=run",)), (signal.SIGTERM, 143, (*ADAM, "hydra.run.dir=run", "resume=auto"))],
    ids=["SIGINT, by directory", "SIGTERM, auto"],
)
def test_an_interrupted_run_goes_on(pinn_run, steps, tmp_path, whole, number, status, how):
    steps.signal_at(10, number)
    stopped = pinn_run(*ADAM, "hydra.run.dir=run")
    assert (stopped.status, stopped.out) == (status, "")
    assert stopped.err == "pinn-run: interrupted; to go on: pinn-run resume=run\n"
    assert {file.name for file in (tmp_path / "run").iterdir()} == HYDRAS | CHECKPOINTS
    steps.undisturbed()
    resumed = pinn_run(*how).done()
    assert steps.taken == list(range(11, 31))
    assert resumed.directory == tmp_path / "run"
    assert_same_numbers(whole, resumed.directory)
    assert {file.name for file in (tmp_path / "run").iterdir()} == {file.name for file in whole.iterdir()}
    assert "going on from the checkpoint" in (tmp_path / "run" / "pinn-run.log").read_text()


@pytest.mark.parametrize("iteration", [17, *(pytest.param(at, marks=pytest.mark.slow) for at in (0, 1, 30))])
def test_a_killed_run_goes_on(pinn_run: PinnRun, steps: Steps, tmp_path: Path, whole: Path, iteration: int) -> None:
    steps.signal_at(iteration, signal.SIGKILL)
    assert in_a_child(lambda: pinn_run(*ADAM, "hydra.run.dir=run")) == -signal.SIGKILL
    steps.undisturbed()
    pinn_run("resume=run").done()
    assert steps.taken == list(range(max(iteration - 1, 0), 31))
    assert_same_numbers(whole, tmp_path / "run")


@pytest.mark.slow
def test_killed_in_its_report_a_run_does_not_train_again(pinn_run, steps, tmp_path, whole, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(netcdf, "write_dataset", lambda *args: os.kill(os.getpid(), signal.SIGKILL))
        assert in_a_child(lambda: pinn_run(*ADAM, "hydra.run.dir=run")) == -signal.SIGKILL
    assert not (tmp_path / "run" / "response.nc").exists()
    steps.undisturbed()
    assert pinn_run("resume=run").status == 0
    assert steps.taken == []
    assert_same_numbers(whole, tmp_path / "run")


def test_a_finished_run_is_left_as_it_is(pinn_run: PinnRun, steps: Steps, tmp_path: Path) -> None:
    directory = pinn_run(*ADAM, "hydra.run.dir=run", "resume=auto").directory  # there is nothing to go on from
    assert steps.taken == list(range(31))
    before = contents(directory)
    steps.undisturbed()
    again = pinn_run("resume=run/")
    assert (again.status, again.out, again.err) == (0, f"finished before, nothing to do\n{directory}\n", "")
    assert contents(directory) == before
    auto = pinn_run(*ADAM, "hydra.run.dir=run", "resume=auto")
    assert (auto.status, auto.out, auto.err) == (0, f"finished before, nothing to do\n{directory}\n", "")
    assert contents(directory) == before
    assert steps.taken == []


def test_a_stale_checkpoint_is_not_taken_up_unasked(pinn_run: PinnRun, steps: Steps, interrupted: Path) -> None:
    again = pinn_run(*ADAM, "hydra.run.dir=run")
    assert again.status == 0
    assert again.err.count("\n") == 1
    assert "resume=auto" in again.err
    assert steps.taken == list(range(31))


def test_auto_starts_over_where_another_run_lies(pinn_run: PinnRun, steps: Steps, interrupted: Path) -> None:
    other = pinn_run(*ADAM, "noise.snr_db=20", "hydra.run.dir=run", "resume=auto").done()
    assert other.err.count("\n") == 1
    assert "noise.snr_db=20 (was 50)" in other.err
    assert steps.taken == list(range(31))
    steps.undisturbed()
    assert "finished before" not in pinn_run(*ADAM, "hydra.run.dir=run", "resume=auto").out
    assert steps.taken == list(range(31))


def test_a_checkpoint_of_another_version_is_refused(pinn_run, interrupted, monkeypatch):
    before = contents(interrupted)
    monkeypatch.setattr(identity, "package_version", lambda package: "9.9")
    pinn_run("resume=run").refused("torch=9.9 (was ")
    assert contents(interrupted) == before


def test_a_diverging_run_says_where_and_keeps_a_good_checkpoint(pinn_run: PinnRun, tmp_path: Path) -> None:
    outcome = pinn_run(*ADAM, "training.learning_rate=1e9", "hydra.run.dir=run")
    assert (outcome.status, outcome.err.count("\n")) == (3, 1)
    for part in ("adam diverged: loss_", "at iteration", "try a training.learning_rate below 1e+09"):
        assert part in outcome.err
    state = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)["trainings"][0]["state"]
    assert all(weight.isfinite().all() for weight in state["network"].values())
    assert pinn_run("resume=run").err == outcome.err


def test_interrupted_before_it_begins_or_in_its_report_a_run_leaves_nothing_half_written(
    pinn_run, tmp_path, monkeypatch
):
    with monkeypatch.context() as patch:
        patch.setattr(Simulated, "measure", lambda *args: os.kill(os.getpid(), signal.SIGTERM))
        stopped = pinn_run(*SMALL, "hydra.run.dir=run")
    assert (stopped.status, stopped.out, stopped.err) == (143, "", "pinn-run: interrupted\n")
    assert not list(tmp_path.iterdir())
    with monkeypatch.context() as patch:
        patch.setattr(pd.DataFrame, "to_csv", lambda *args, **kwargs: os.kill(os.getpid(), signal.SIGINT))
        stopped = pinn_run(*SMALL, "hydra.run.dir=run")
    assert stopped.status == 130
    assert {file.name for file in (tmp_path / "run").iterdir()} <= HYDRAS | CHECKPOINTS


def test_it_goes_on_with_its_own_configuration(pinn_run: PinnRun, tmp_path: Path, monkeypatch) -> None:
    seen: list[DictConfig] = []
    home, name = tmp_path / "home", "it's = a 'strange' place, 50"
    home.mkdir()
    monkeypatch.chdir(home)
    quotes = name.replace("'", "\\'")
    given = (*SMALL, "network=mlp", "seed=7", f"hydra.run.dir='../{quotes}'")
    pinn_run(*given, task=seen.append)
    stored = contents(tmp_path / name / ".hydra")
    monkeypatch.chdir(tmp_path)

    def note(config: DictConfig) -> None:
        seen.append(config)
        assert Path.cwd() == home

    pinn_run(f"resume={name}", "threads=2", "training.checkpoint_every_s=null", task=note).done()
    expected = seen[0].copy()
    changes = {"threads": 2, "training.checkpoint_every_s": None, "resume": str(tmp_path / name)}
    for setting, value in changes.items():
        OmegaConf.update(expected, setting, value)
    assert seen[1] == expected
    assert contents(tmp_path / name / ".hydra") == stored


REFUSED = {
    "no such directory": (["resume=nowhere"], ["resume=nowhere:", "null, auto, never, or the directory of a run"]),
    "no run": (["resume=empty"], ["resume=empty:", "no .hydra/config.yaml"]),
    "a sweep": (["resume=sweep"], ["resume=sweep:", "name one of its jobs"]),
    "broken": (["resume=broken"], ["resume=broken:", "cannot be read"]),
    "other settings": (["resume=empty", "seed=1"], ["resume=empty:", "drop seed=1"]),
    "in a sweep": (["-m", "resume=empty"], ["resume=empty:", "--multirun"]),
    "only printed": (["--cfg", "job", "resume=empty"], ["resume=empty:", "--cfg"]),
    "a directory of its own": (["resume=auto"], ["resume=auto:", "fixed hydra.run.dir"]),
    "no word": (["resume=3"], ["resume=3:", "no such directory"]),
}


@pytest.mark.parametrize(("arguments", "told"), REFUSED.values(), ids=REFUSED.keys())
def test_what_cannot_be_resumed(pinn_run: PinnRun, tmp_path: Path, arguments: list[str], told: list[str]) -> None:
    for name in ("empty", "sweep", "broken/.hydra"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "sweep" / "multirun.yaml").write_text("")
    (tmp_path / "broken" / ".hydra" / "config.yaml").write_text("a: [")
    before = sorted(tmp_path.rglob("*"))
    pinn_run(*arguments).refused(*told)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("training", sorted(option_names("training")))
def test_every_training_takes_the_interval(composed: Compose, training: str) -> None:
    assert RunConfig.read(composed(f"training={training}", "threads=1")).checkpoint_every_s == 30.0
    off = composed(f"training={training}", "threads=1", "training.checkpoint_every_s=null")
    assert RunConfig.read(off).checkpoint_every_s is None
    with pytest.raises(InputError, match=r"training\.checkpoint_every_s=-1"):
        RunConfig.read(composed(f"training={training}", "threads=1", "training.checkpoint_every_s=-1"))


@pytest.mark.slow
def test_an_interrupted_training_that_keeps_nothing_says_so(pinn_run, monkeypatch, tmp_path):
    monkeypatch.setattr(Evidence, "train", lambda *args, **settings: os.kill(os.getpid(), signal.SIGINT))
    stopped = pinn_run(*SMALL, "hydra.run.dir=run")
    assert (stopped.status, stopped.out) == (130, "")
    assert stopped.err == "pinn-run: interrupted; nothing is kept of it; to start over: pinn-run resume=run\n"
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    pinn_run("resume=run", "figures=false").done()


MLP = (*SMALL, "network=mlp", "training.collocation_points=60", "figures=false")


@pytest.mark.slow
def test_a_long_step_is_broken_off_and_taken_anew(pinn_run, monkeypatch, tmp_path):
    pinn_run(*MLP, "hydra.run.dir=whole").done()
    factor, taken, survived = NetworkSystem.factor, [], []

    def stopped_in_the_third(*arguments: object) -> object:
        taken.append(1)
        if len(taken) == 3:
            os.kill(os.getpid(), signal.SIGTERM)
            survived.append(1)
        return factor(*arguments)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(NetworkSystem, "factor", stopped_in_the_third)
        stopped = pinn_run(*MLP, "hydra.run.dir=run")
    assert stopped.status == 143
    assert stopped.err == "pinn-run: interrupted; to go on: pinn-run resume=run\n"
    assert (len(taken), survived) == (3, [])
    pinn_run("resume=run").done()
    assert_same_numbers(tmp_path / "whole", tmp_path / "run")


CSV = ("data=csv", "data.path=rig.csv")


@pytest.mark.parametrize(
    "override",
    ["threads=2", "device=cuda", "resume=auto", "training.checkpoint_every_s=1", "noise.snr_db=50", "tracking=mlflow"],
)
def test_where_and_how_it_is_made_makes_no_other_run(composed: Compose, override: str) -> None:
    assert Identity.of(composed(override)) == Identity.of(composed())


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("seed=1", "seed=1 (was 0)"),
        ("noise.snr_db=null", "noise.snr_db=null (was 50)"),
        ("system.k=[1,2.50,3]", "system.k=[1,2.5,3] (was 15)"),
        ("training.learn_spread=false", "training.learn_spread=False (was True)"),
    ],
)
def test_a_change_is_named(composed: Compose, override: str, told: str) -> None:
    now, was = Identity.of(composed(override)), Identity.of(composed())
    assert now.changes_from(was) == [told]
    assert Identity({"a": "1"}, {}).changes_from(Identity({}, {})) == ["a=1 (was (none))"]
    assert now.configuration != was.configuration


def test_a_pipe_has_no_content_and_is_not_waited_for(composed: Compose, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "rig.csv")
    assert Identity.of(composed(*CSV), tmp_path).settings["data.path"] == "rig.csv"


FILES = {
    "data.path": (CSV, "rig.csv"),
    "excitation.path": (("excitation=ground_motion", "excitation.path=quake.txt"), "quake.txt"),
    "data.path at home": (("data=csv", 'data.path="~/rig.csv"'), "rig.csv"),
}


@pytest.mark.parametrize(("given", "name"), FILES.values(), ids=FILES.keys())
def test_a_file_counts_by_what_is_in_it(composed, tmp_path, monkeypatch, given, name):
    monkeypatch.setenv("HOME", str(tmp_path))
    config, elsewhere = composed(*given), tmp_path / "elsewhere"
    elsewhere.mkdir()
    for folder in (tmp_path, elsewhere):
        (folder / name).write_text("t,f\n0,1\n")
    was = Identity.of(config, tmp_path)
    assert Identity.of(config, elsewhere) == was
    (tmp_path / name).write_text("t,f\n0,2\n")
    (change,) = Identity.of(config, tmp_path).changes_from(was)
    assert re.match(r"\w+\.path=file of SHA-256", change)
