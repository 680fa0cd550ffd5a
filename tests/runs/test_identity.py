"""Which settings and files make a run another run."""

import os
import re
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
