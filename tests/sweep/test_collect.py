"""`pinn-run collect=DIRECTORY`."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from calls import PinnRun
from sweeps import made_sweep

HEAD = "estimator,group,quantity,fitness_percent,range_fitness_percent\n"


def table(percent: float) -> str:
    return HEAD + "".join(f"pinn,all,{quantity},{percent},{percent}\n" for quantity in ("displacement", "velocity"))


def test_a_sweep_that_was_cut_off_is_put_together(pinn_run: PinnRun, tmp_path: Path) -> None:
    tables = {"system.ndof=3": table(99.0), "system.ndof=6": table(90.0), "system.ndof=9": None}
    made_sweep(tmp_path / "sweep", ["system.ndof=3,6,9,12"], tables)
    outcome = pinn_run("collect=sweep")
    assert outcome.status == 0, outcome.err
    assert outcome.out.startswith("4 jobs: 2 finished, 1 failed, 1 not started\n  system.ndof=9: no luck, at all\n")
    assert outcome.out.endswith("\nsweep\n")
    assert pd.read_csv(outcome.directory / "summary.csv")["fitness_percent_mean"].tolist() == [99, 99, 90, 90]
    assert {path.name for path in outcome.directory.glob("figures/*")} == {"fitness.png", "fitness.pdf"}
    assert len(pd.read_csv(outcome.directory / "jobs.csv")) == 4


def test_collecting_again_gives_the_same(pinn_run: PinnRun, tmp_path: Path) -> None:
    made_sweep(tmp_path / "sweep", ["seed=0,1"], {"seed=0": table(99.0), "seed=1": table(98.0)})
    files = [tmp_path / "sweep" / name for name in ("fitness.csv", "jobs.csv", "summary.csv")]
    first = [pinn_run("collect=sweep").out, *(file.read_bytes() for file in files)]
    assert [pinn_run("collect=sweep").out, *(file.read_bytes() for file in files)] == first


def test_a_sweep_that_has_not_begun(pinn_run: PinnRun, tmp_path: Path) -> None:
    made_sweep(tmp_path / "sweep", ["seed=0,1"], {})
    assert pinn_run("collect=sweep").out == "2 jobs: 2 not started\nsweep\n"
    assert [path.name for path in (tmp_path / "sweep").iterdir()] == ["multirun.yaml"]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["collect=nowhere"], "there is no such directory"),
        (["collect=."], "it holds no multirun.yaml"),
        (["collect=.", "seed=1"], "given alone; drop seed=1"),
        (["-m", "collect=."], "given alone; drop --multirun"),
    ],
)
def test_what_cannot_be_collected(pinn_run: PinnRun, arguments: list[str], told: str) -> None:
    outcome = pinn_run(*arguments)
    assert (outcome.status, outcome.err.count("\n")) == (2, 1)
    assert outcome.err.startswith("pinn-run: collect=")
    assert told in outcome.err
