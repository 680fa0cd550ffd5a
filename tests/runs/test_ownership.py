"""A run writes where nothing lies, or where pinn-run wrote before: nobody's own files are replaced or deleted."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from calls import PinnRun
from interrupted_runs import ADAM, contents

from pinn_cli.runs.claim import check_destination
from pinn_cli.settings.errors import InputError

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
    outcome = pinn_run(*given)
    assert outcome.status == 2
    assert "dir=" in outcome.err
    assert outcome.err.startswith("pinn-run: hydra.")
    assert contents(tmp_path) == mine
    assert {entry.name for entry in tmp_path.iterdir() if entry.is_dir()} == {"deep"}


def test_an_empty_directory_and_an_earlier_run_are_taken(pinn_run: PinnRun, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for _ in range(2):
        assert pinn_run(*QUICK, "hydra.run.dir=empty").status == 0
    (tmp_path / "empty" / "notes.txt").write_text("mine")
    assert pinn_run(*QUICK, "hydra.run.dir=empty").status == 0
    assert (tmp_path / "empty" / "notes.txt").read_text() == "mine"


def test_settings_of_another_program_are_no_mark(tmp_path: Path) -> None:
    (tmp_path / ".hydra").mkdir()
    (tmp_path / ".hydra" / "hydra.yaml").write_text("hydra: {job: {name: other}}")
    (tmp_path / "checkpoint.pt").write_text("mine")
    with pytest.raises(InputError, match=r"hydra\.run\.dir=.*pinn-run made; files of yours"):
        check_destination(tmp_path, "hydra.run.dir")


def test_something_else_in_the_place_of_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / ".hydra").mkdir()
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
