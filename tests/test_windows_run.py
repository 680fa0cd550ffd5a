"""Runs by windows, through the whole program: changes are told where they are, and kills change no number."""

import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calls import SMALL, PinnRun
from independent_records import Structure, measured
from storeys import RATE, C, K, M, record, response, system, written
from sweeps import start

from pinn_cli.record.response import Response

KNOWN = (*system(1.02 * K), "scheme.parameter_uncertainty=0.05", "figures=false")
WINDOWS = ("data.window=4", "data.overlap=1")
TABLES = ("parameters.csv", "parameters_over_time.csv", "windows.csv", "fitness.csv", "residuals.csv", "drift.csv")


def parameters(run: str) -> pd.DataFrame:
    return pd.read_csv(f"{run}/parameters.csv").set_index("parameter")


@pytest.mark.slow
def test_windows_come_to_what_the_whole_record_says(pinn_run: PinnRun, tmp_path: Path) -> None:
    each = record(3, duration=10.02)
    data = written(each.record, tmp_path / "one.csv")
    pinn_run(*KNOWN, *data, "hydra.run.dir=whole").done()
    done = pinn_run(*KNOWN, *data, *WINDOWS, "hydra.run.dir=parts").done()
    assert "window 2, 3 to 7 s: sound" in done.out
    assert done.out.strip().splitlines()[-2:] == ["verdict: sound", str(tmp_path / "parts")]
    ours, theirs = parameters("parts"), parameters("whole")
    assert list(ours.index) == list(theirs.index)
    assert (ours["prescribed"] == theirs["prescribed"]).all()
    assert ((ours["estimate"] - theirs["estimate"]).abs() < 0.5 * theirs["std"]).all()
    # Nothing is counted twice, and what the model leaves out is as small as all windows together say.
    assert (ours["std"] / theirs["std"]).between(0.95, 1.15).all()
    with xr.open_dataset("parts/response.nc") as a, xr.open_dataset("whole/response.nc") as b:
        np.testing.assert_allclose(a["time"], b["time"])
        error, others = (each_["displacement"] - each.truth.displacement for each_ in (a, b))
        assert 0.75 < float((np.abs(error) < 1.645 * a["displacement_std"]).mean()) <= 1.0
        assert float((error**2).mean()) < 1.1 * float((others**2).mean())
        assert set(a.variables) == set(b.variables)
    told = json.loads(Path("parts/run.json").read_text())
    assert [w["number"] for w in told["windows"]] == [1, 2, 3]
    assert (told["verdict"], told["windows"][-1]["hand_over"]) == ("sound", None)
    table = pd.read_csv("parts/parameters_over_time.csv")
    assert table["record"].unique().tolist() == [1, 2, 3]
    assert not table["changed"].any()
    assert (np.diff(table[table["parameter"] == "k_2"]["std"].to_numpy()) < 0.0).all()

    follow_what_grows(pinn_run, tmp_path, data)


def follow_what_grows(pinn_run: PinnRun, tmp_path: Path, data: tuple[str, ...]) -> None:
    """It ends when nothing comes, goes on when more does, and comes to the same numbers."""
    lines = (tmp_path / "one.csv").read_text().splitlines(keepends=True)
    growing = tmp_path / "growing.csv"
    follow = [argument.replace("one.csv", "growing.csv") for argument in ("follow", *KNOWN, *data, *WINDOWS)]
    follow += ["follow.until_idle=0.1", "follow.poll=0.05"]
    for text in ("".join(lines[:300]) + lines[300][:5], "".join(lines)):
        growing.write_text(text)
        done = pinn_run(*follow).done()
    assert done.directory == tmp_path / "outputs/default/follow"
    assert "window 1," not in done.out
    assert "window 3," in done.out
    for name in TABLES:
        assert (done.directory / name).read_bytes() == Path("parts", name).read_bytes(), name
    other = pinn_run(*follow, "seed=3").refused()
    assert "windows of another run lie there" in other.err


@pytest.mark.slow
def test_windows_that_are_there_are_not_solved_again(pinn_run: PinnRun, tmp_path: Path) -> None:
    data = written(record(3, duration=10.02).record, tmp_path / "one.csv")
    pinn_run(*KNOWN, *data, *WINDOWS, "hydra.run.dir=run").done()
    kept = {name: Path("run", name).read_bytes() for name in TABLES}
    shutil.rmtree("run/windows/0003")
    Path("run/run.json").unlink()
    Path("run/windows/0003").mkdir()
    Path("run/windows/0003/.response.4711.partial.nc").write_text("half")
    again = pinn_run("resume=run").done()
    assert "window 2" not in again.out
    assert "window 3" in again.out
    assert {name: Path("run", name).read_bytes() for name in TABLES} == kept
    assert not list(Path("run").rglob("*.partial.*"))
    assert "nothing to do" in pinn_run("resume=run").out
    known = parameters("run")
    pinn_run("model=run", *written(record(4).record, tmp_path / "two.csv"), *WINDOWS, "hydra.run.dir=next").done()
    assert (parameters("next")["std"] < known["std"]).all()


@pytest.mark.slow
def test_a_simulated_record_by_windows(pinn_run: PinnRun) -> None:
    """Its truth is known: fitness is that of the whole record."""
    common = (*SMALL, "figures=false", "noise.snr_db=30", "scheme.unobserved=[2]")
    pinn_run(*common, "data.window=5", "hydra.run.dir=run").done()
    assert pinn_run(*common, "hydra.run.dir=whole").status == 0
    fitness = [pd.read_csv(f"{run}/fitness.csv").set_index(["group", "quantity"]) for run in ("run", "whole")]
    assert fitness[0].index.equals(fitness[1].index)
    ours, theirs = (table.loc[("all", "displacement"), "fitness_percent"] for table in fitness)
    assert ours > theirs - 1.0
    assert parameters("run")["true"].notna().all()


def test_what_windows_have_not(pinn_run: PinnRun, tmp_path: Path) -> None:
    data = written(record(3).record, tmp_path / "one.csv")
    file = tmp_path / "one.csv"
    file.write_text("".join(f"{line},{'a4' if i == 0 else i}\n" for i, line in enumerate(file.read_text().split())))
    doubtful = "data.channels={roof: {sensor: displacement, column: a4, dof: 2, gain: {uncertainty: 0.05, value: 1}}}"
    simulated, measured = (*SMALL, "data.window=5"), (*KNOWN, *data, *WINDOWS)
    for arguments, told in (
        ((*simulated, "scheme=bayesian"), "scheme=bayesian: must be"),
        ((*simulated, "network=mlp"), "network=mlp: must be"),
        ((*simulated, "baseline=kalman_smoother"), "baseline=kalman_smoother: must be"),
        ((*simulated, "validation=heldout"), "validation=heldout: must be"),
        ((*simulated, "data.overlap=3"), "data.overlap=3.0: must be at most half"),
        ((*measured, "data.decimate=2"), "data.decimate=2"),
        ((*measured, "data.validation={start: 6, stop: 9}"), "data.validation"),
        ((*measured, doubtful), "data.channels.roof.gain"),
        ((*KNOWN, *data, "data.overlap=2"), "null without data.window"),
        (("follow", *KNOWN, *data), "given with follow, in seconds"),
        (("follow", *simulated), "csv or another format of files with follow"),
        (("follow", *measured, "resume=auto"), "left out with follow"),
        (("follow", *measured, "--multirun"), "left out with follow"),
        (("follow", *measured, "follow.poll=0"), "follow.poll=0"),
    ):
        pinn_run(*arguments).refused(told)
    assert not Path("outputs").exists()


DURATION = 30.0
# Windows of 9 s each 7 s: 0 to 9, 7 to 16, 14 to 23, 21 to 30.
LONG_WINDOWS = ("data.window=9", "data.overlap=2")
BEGINS = (0.0, 7.0, 14.0, 21.0)


def softened(seed: int, when: float, left: float) -> Response:
    """Motion whose second spring falls to a part of its stiffness at a time, s."""
    first = response(seed, duration=when)
    state = response(seed, duration=when + 1.0 / RATE)
    start = np.append(state.displacement[-1], state.velocity[-1])
    second = response(seed, K * np.array([1.0, left, 1.0]), DURATION - when, start, when)
    both = ("time", "displacement", "velocity", "acceleration", "force")
    return Response(*(np.concatenate([getattr(one, name) for one in (first, second)]) for name in both))


@pytest.mark.parametrize(
    ("seed", "when", "left"),
    [
        pytest.param(2, 18.0, 0.92, marks=pytest.mark.slow),  # inside one
        pytest.param(3, 15.0, 0.95, marks=pytest.mark.slow),  # in what two have in common
        pytest.param(4, 26.0, 0.9, marks=pytest.mark.slow),  # in the last one
        pytest.param(5, 18.0, 1.0, marks=pytest.mark.slow),
    ],
)
def test_a_change_is_told_where_it_is(pinn_run: PinnRun, tmp_path: Path, seed: int, when: float, left: float) -> None:
    truth = softened(seed, when, left)
    structure = Structure(M, C, K, np.zeros(3))
    data = written(measured(structure, truth, {"acceleration": (1, 2, 3)}, 30.0, seed).record, tmp_path / "one.csv")
    known = (*system(1.02 * K), "scheme.parameter_uncertainty=0.05")
    pinn_run(*known, *data, *LONG_WINDOWS, "hydra.run.dir=run").done()
    told = pd.read_csv("run/windows.csv", keep_default_na=False).set_index("window")["changed"].str.split()
    flagged = [number for number, names in told.items() if names]
    if left == 1.0:
        assert not flagged, told
        return
    containing = [number for number, begin in enumerate(BEGINS, start=1) if begin - 0.5 / RATE < when < begin + 9.0]
    assert len(flagged) == 1, told
    assert flagged[0] in containing
    # A window that holds both values has a model that is wrong: what else moves in it is named after it.
    assert told[flagged[0]][0] == "k_2"
    found = pd.read_csv("run/parameters.csv").set_index("parameter").loc["k_2"]
    if flagged[0] < 4:  # a window that holds both says something between the two
        assert abs(found["estimate"] - left * K[1]) < 3.0 * found["std"]


# How long each step took is never the same.
TIMED = {"history.csv"}
KILLED = (*system(1.02 * K), "scheme.parameter_uncertainty=0.05", "figures=false", "threads=1")
PATIENCE = ("follow.poll=0.05", "follow.until_idle=1")


def killed_after(process: subprocess.Popen[str], done: Path, later: float) -> None:
    """SIGKILL so many seconds after a file is there."""
    until = time.monotonic() + 120.0
    while not done.is_file():
        assert process.poll() is None, "it has ended by itself"
        assert time.monotonic() < until, f"{done} does not come"
        time.sleep(0.005)
    time.sleep(later)
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL


def assert_same_numbers(one: Path, other: Path) -> None:
    """Bit for bit."""
    tables = [{file.name for file in place.glob("*.csv")} - TIMED for place in (one, other)]
    assert "parameters.csv" in tables[0]
    assert tables[0] == tables[1]
    for name in tables[0]:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    with xr.open_dataset(one / "response.nc") as first, xr.open_dataset(other / "response.nc") as second:
        assert first.identical(second)
    assert not list(other.rglob("*.partial*"))


@pytest.mark.slow
def test_killed_windows_end_with_the_same_numbers(tmp_path: Path) -> None:
    data = written(record(3, duration=10.02).record, tmp_path / "one.csv")
    command = (*KILLED, *data, *WINDOWS)
    assert start(tmp_path, *command, "hydra.run.dir=whole").wait() == 0
    place = tmp_path / "run" / "windows"
    killed_after(start(tmp_path, *command, "hydra.run.dir=run"), place / "0001" / "window.json", 0.0)
    kept = (place / "0001" / "window.json").stat().st_mtime_ns
    killed_after(start(tmp_path, *command, "hydra.run.dir=run", "resume=auto"), place / "0002" / "window.json", 0.1)
    assert start(tmp_path, *command, "hydra.run.dir=run", "resume=auto").wait() == 0
    assert (place / "0001" / "window.json").stat().st_mtime_ns == kept
    assert_same_numbers(tmp_path / "whole", tmp_path / "run")


@pytest.mark.slow
def test_a_killed_follower_ends_with_the_same_numbers(tmp_path: Path) -> None:
    """Of a file that grows while nobody looks."""
    data = written(record(3, duration=10.02).record, tmp_path / "one.csv")
    lines = (tmp_path / "one.csv").read_text().splitlines(keepends=True)
    undisturbed = (*KILLED, *data, *WINDOWS)
    assert start(tmp_path, *undisturbed, "hydra.run.dir=whole").wait() == 0
    growing = tmp_path / "growing.csv"
    growing.write_text("".join(lines[:260]) + lines[260][:7])
    source = [argument.replace("one.csv", "growing.csv") for argument in data]
    follow = ("follow", *KILLED, *source, *WINDOWS, "hydra.run.dir=run", *PATIENCE)
    place = tmp_path / "run" / "windows"
    # Its second window is what is being waited for, or what had come when nothing more did.
    killed_after(start(tmp_path, *follow[:-1]), place / "0001" / "window.json", 0.3)
    growing.write_text("".join(lines[:400]))
    killed_after(start(tmp_path, *follow[:-1]), place / "0002" / "window.json", 0.0)
    growing.write_text("".join(lines))
    assert start(tmp_path, *follow).wait() == 0
    assert_same_numbers(tmp_path / "whole", tmp_path / "run")
