"""Event files of a run, read back by TensorBoard's own reader."""

import os
import signal
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from calls import SMALL, PinnRun
from interrupted_runs import ADAM, Steps, in_a_child

from pinn_cli.cli.command_line import execute
from pinn_cli.main import run
from pinn_cli.settings.errors import InputError
from pinn_cli.training.gradient.training import Descent

pytest.importorskip("tensorboard", reason="the extra tensorboard is not installed")


def events(folder: Path) -> Any:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    found = EventAccumulator(str(folder), size_guidance={"images": 0, "scalars": 0, "tensors": 0})
    found.Reload()
    return found


@pytest.mark.slow
def test_an_interrupted_run_is_one_run_in_the_end(pinn_run, monkeypatch, tmp_path):
    steps = Steps(monkeypatch)
    steps.signal_at(10, signal.SIGINT)
    assert pinn_run(*ADAM, "tracking=tensorboard", "hydra.run.dir=run").status == 130
    steps.undisturbed()
    pinn_run("resume=run").done()
    found = events(tmp_path / "run" / "tensorboard")
    history = pd.read_csv(tmp_path / "run" / "history.csv")
    assert [e.step for e in found.Scalars("loss/observation")] == history["iteration"].tolist()
    assert found.Scalars("loss/observation")[-1].value == pytest.approx(history["loss_observation"].iloc[-1], rel=1e-5)
    assert found.Scalars("results/fitness_percent/velocity")
    tags = found.Tags()
    assert {"response", "history"} <= set(tags["images"])
    assert {"settings/text_summary", "status/text_summary"} <= set(tags["tensors"])
    assert "_hparams_/experiment" in found.PluginTagToContent("hparams")
    text = found.Tensors("settings/text_summary")[0].tensor_proto.string_val[0].decode()
    assert "| system.ndof | 3 |" in text


def test_rows_between_the_last_note_and_a_kill_are_there_once(pinn_run: PinnRun, tmp_path: Path) -> None:
    """The checkpoint that a killed run goes on from is younger than the last rows that its tracker was told."""
    command = (*ADAM, "training.history_every=1", "tracking=tensorboard", "hydra.run.dir=run", "resume=auto")

    def killed() -> None:
        step = Descent.step
        Descent.step = lambda self: os.kill(os.getpid(), signal.SIGKILL) if self.iteration == 10 else step(self)  # type: ignore[method-assign,func-returns-value,assignment,return-value]
        sys.argv = ["pinn-run", *command]
        execute(run)

    os.chdir(tmp_path)
    assert in_a_child(killed) == -signal.SIGKILL
    pinn_run(*command, "figures=false").done()
    history = pd.read_csv(tmp_path / "run" / "history.csv")
    found = events(tmp_path / "run" / "tensorboard")
    assert [e.step for e in found.Scalars("loss/observation")] == history["iteration"].tolist()


@pytest.mark.slow
def test_in_a_folder_with_files_of_others_those_stay(pinn_run: PinnRun, tmp_path: Path) -> None:
    """Whether the run is new, takes another one's place, or is refused."""
    place = tmp_path / "boards" / "default" / "run"
    place.mkdir(parents=True)
    of_another = place / "events.out.tfevents.1700000000.host.1.0"
    of_another.write_bytes(b"of another program")
    command = (*SMALL, "tracking=tensorboard", "tracking.directory=boards", "hydra.run.dir=run", "figures=false")
    mine = set[Path]()
    for more in ((), ("resume=never",)):
        assert pinn_run(*command, *more).status == 0
        before, mine = mine, set(place.iterdir()) - {of_another}
        assert mine
        assert not mine & before
    assert not (tmp_path / "run" / "tensorboard").exists()
    assert pinn_run(*command, "resume=never", "system.m=-1").status == 2
    assert of_another.read_bytes() == b"of another program"


def test_impossible_settings_are_named(pinn_run: PinnRun, tmp_path: Path) -> None:
    from pinn_cli.sweep.tracking.tensorboard import TensorboardTracking

    with pytest.raises(InputError, match=r"tracking\.directory"):
        TensorboardTracking(5)  # type: ignore[arg-type]
    (tmp_path / "file").write_text("")
    pinn_run(*ADAM, "tracking=tensorboard", "tracking.directory=file").refused()
