"""Which settings and files make a run another run."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from calls import Compose

from pinn_cli.runs.identity import Identity

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
    assert now.configuration != was.configuration


def test_a_file_counts_by_what_is_in_it(composed: Compose, tmp_path: Path) -> None:
    config = composed(*CSV)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "rig.csv").write_text("t,f\n0,1\n")
    (tmp_path / "elsewhere" / "rig.csv").write_text("t,f\n0,1\n")
    was = Identity.of(config, tmp_path)
    assert Identity.of(config, tmp_path / "elsewhere") == was
    (tmp_path / "rig.csv").write_text("t,f\n0,2\n")
    (change,) = Identity.of(config, tmp_path).changes_from(was)
    assert change.startswith("data.path=file of SHA-256")
    (tmp_path / "rig.csv").unlink()
    assert Identity.of(config, tmp_path).settings["data.path"] == "rig.csv"


def test_a_file_in_the_home_folder_counts_by_what_is_in_it(
    composed: Compose, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    config = composed("data=csv", 'data.path="~/rig.csv"')
    (tmp_path / "rig.csv").write_text("t,f\n0,1\n")
    was = Identity.of(config, tmp_path / "elsewhere")
    (tmp_path / "rig.csv").write_text("t,f\n0,2\n")
    (change,) = Identity.of(config, tmp_path / "elsewhere").changes_from(was)
    assert change.startswith("data.path=file of SHA-256")


def test_a_pipe_has_no_content_and_is_not_waited_for(composed: Compose, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "rig.csv")
    assert Identity.of(composed(*CSV), tmp_path).settings["data.path"] == "rig.csv"


def test_a_recorded_ground_motion_counts_by_what_is_in_it(composed: Compose, tmp_path: Path) -> None:
    config = composed("excitation=ground_motion", "excitation.path=quake.txt")
    (tmp_path / "quake.txt").write_text("0 1\n")
    was = Identity.of(config, tmp_path)
    (tmp_path / "quake.txt").write_text("0 2\n")
    (change,) = Identity.of(config, tmp_path).changes_from(was)
    assert change.startswith("excitation.path=file of SHA-256")
