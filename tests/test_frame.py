"""Structures in SI units, recorded by another simulator, through the whole program."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calls import PinnRun
from independent_records import IndependentRecord, frame_record

from pinn_cli.report.fitness import fitness_percent

WITHIN_95 = 1.959964
UNKNOWN = ("scheme=state_parameter", "scheme.unknown=[k_*,kappa_1]")


@pytest.fixture
def made() -> IndependentRecord:
    return frame_record(rate=100.0, duration=20.0)


def written(made: IndependentRecord, folder: Path) -> tuple[str, ...]:
    """The record as a file, and the settings that name its columns and the structure."""
    record, s = made.record, made.structure
    columns = {"t": record.time, "f": record.force[:, 2], **{f"a{i + 1}": record.acceleration[:, i] for i in range(3)}}
    pd.DataFrame(columns).to_csv(folder / "frame.csv", index=False)
    structure = [f"system.{kind}={getattr(s, kind).tolist()}" for kind in ("m", "c", "k", "kappa")]
    return (
        "system=duffing", "system.ndof=3", *structure, "data=csv", f"data.path={folder / 'frame.csv'}", "data.time=t",
        "data.force={3: f}", "data.acceleration={1: a1, 2: a2, 3: a3}", "figures=false",
    )  # fmt: skip


@pytest.mark.slow
def test_the_motion_of_a_known_frame(pinn_run: PinnRun, made: IndependentRecord, tmp_path: Path) -> None:
    done = pinn_run(*written(made, tmp_path)).done()
    with xr.open_dataset(done.directory / "response.nc") as response:
        for quantity, least in (("displacement", 98.5), ("velocity", 98.5), ("acceleration", 97.0)):
            true, found = getattr(made.truth, quantity), response[quantity].values
            assert np.mean(fitness_percent(found, true)) >= least, quantity
            inside = np.abs(found - true) < WITHIN_95 * response[f"{quantity}_std"].values
            assert 0.85 < inside.mean() < 0.995, quantity
    assert done.record["verdict"] == "sound", done.record["reasons"]


@pytest.mark.slow
def test_unknown_springs_from_the_default_start(pinn_run: PinnRun, made: IndependentRecord, tmp_path: Path) -> None:
    nothing = ("system.k=null", "system.kappa=[null,0,0]")
    done = pinn_run(*written(made, tmp_path), *UNKNOWN, *nothing).done()
    table, s = done.parameters, made.structure
    for i in range(3):
        row = table.loc[f"k_{i + 1}"]
        assert row["estimate"] == pytest.approx(s.k[i], rel=0.01)
        assert row["estimate"] == pytest.approx(s.k[i], abs=4.0 * row["std"])
    assert table.loc["kappa_1", "estimate"] == pytest.approx(s.kappa[0], rel=0.1)
    assert done.record["verdict"] == "sound", done.record["reasons"]


@pytest.mark.parametrize("factor", [0.01, 100.0])
@pytest.mark.slow
def test_a_start_a_hundred_times_off_ends_at_the_truth(pinn_run: PinnRun, tmp_path: Path, factor: float) -> None:
    made = frame_record(rate=100.0, duration=8.0)
    start = ", ".join(f"k_{i + 1}: {factor * k:.0f}" for i, k in enumerate(made.structure.k))
    unknown = ("scheme=state_parameter", "scheme.unknown=[k_*]", f"scheme.initial={{{start}}}")
    done = pinn_run(*written(made, tmp_path), *unknown).done()
    np.testing.assert_allclose(done.parameters.loc[["k_1", "k_2", "k_3"], "estimate"], made.structure.k, rtol=0.01)


RIG = Path(__file__).parents[1].parent / "shared" / "tools" / "rig.py"
# One to eight storeys; stiffnesses are unknown and prescribed up to a decade off in the second experiment.
SEEDS = ("6", "8")


def tool(*arguments: str) -> str:
    return subprocess.run([sys.executable, str(RIG), *arguments], check=True, capture_output=True, text=True).stdout


@pytest.mark.slow
@pytest.mark.skipif(not RIG.is_file(), reason=f"there is no {RIG.name} beside the checkout")
@pytest.mark.parametrize("experiment", ["rig", "rig_unknown"])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_random_structure_is_estimated_right_and_called_sound(pinn_run, tmp_path, seed, experiment):
    tool("make", str(tmp_path / "rig"), "--seed", seed)
    done = pinn_run("--config-dir", str(tmp_path / "rig"), f"experiment={experiment}", "figures=false").done()
    score = json.loads(tool("score", str(tmp_path / "rig"), str(done.directory)))
    assert score["verdict"] == "sound"
    assert score["inside_u"] >= 0.7
    assert score["k_error_percent"] < 10.0
    assert score["k_error_std"] < 5.0
