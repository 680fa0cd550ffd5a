"""`run`, `inspect` and `modes` find what the commands find, and give the process back as it was."""

import asyncio
import gc
import json
import logging
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import threadpoolctl  # noqa: F401  # which sets a variable of the environment, for good
import torch
from calls import SMALL, PinnRun
from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from vibrating_records import BUILDING, of_building

import pinn_cli
from pinn_cli import DivergenceError, InputError, NotSoundError, Record, Result, Structure, inspect, load, modes, run
from pinn_cli.runs.interruption import asked, deferred

QUICK = (*SMALL, "figures=false")
FILES = ("fitness.csv", "parameters.csv", "response.nc", "residuals.csv", "modes.csv", "drift.csv")


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def refused(*overrides: str, **given: object) -> str:
    """The one line of an error, after which nothing is left."""
    before = set(Path().rglob("*"))
    with pytest.raises(InputError) as caught:
        run(*overrides, **given)  # type: ignore[call-overload]
    assert set(Path().rglob("*")) == before
    assert len(caught.traceback) < 9  # none that leads through Hydra
    assert caught.value.__cause__ is None
    return str(caught.value)


def test_every_name_is_there_and_nothing_slow_is_imported_for_it() -> None:
    code = "import sys, pinn_cli; dir(pinn_cli); print([m for m in ('numpy', 'torch', 'hydra') if m in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "[]\n"
    assert all(getattr(pinn_cli, name) is not None and name in dir(pinn_cli) for name in pinn_cli.__all__)
    with pytest.raises(AttributeError, match="sweeep"):
        pinn_cli.sweeep  # noqa: B018


@pytest.mark.slow
def test_the_same_seed_gives_the_command_s_results_bit_for_bit(tmp_path: Path) -> None:
    # In a process that has loaded the linear algebra with as many threads as it likes, as a notebook has.
    code = f"import scipy.linalg\nfrom pinn_cli import run\nprint(run(*{QUICK!r}, directory='python').directory)"
    many = {**os.environ, "OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"}
    for command in (["-c", code], ["-m", "pinn_cli.main", *QUICK, "hydra.run.dir=shell"]):
        done = subprocess.run([sys.executable, *command], env=many, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    for name in FILES:
        assert (tmp_path / "python" / name).read_bytes() == (tmp_path / "shell" / name).read_bytes(), name
    records = [json.loads((tmp_path / place / "run.json").read_text()) for place in ("python", "shell")]
    assert records[0]["configuration"] == records[1]["configuration"]
    assert records[0]["training"] == records[1]["training"]


def state() -> dict[str, object]:
    """What belongs to the process."""
    root, package = logging.getLogger(), logging.getLogger("pinn_cli")
    return {
        "arguments": list(sys.argv),
        "folder": os.getcwd(),
        "environment": dict(os.environ),
        "handlers": [(handler, list(handler.filters), handler.level) for handler in root.handlers],
        "levels": (root.level, package.level, list(package.handlers), package.propagate),
        "signals": [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)],
        "threads": torch.get_num_threads(),
        "torch": torch.get_rng_state().tolist(),
        "numpy": str(np.random.get_state()),  # noqa: NPY002
        "python": random.getstate(),
        "hydra": GlobalHydra.instance(),
        "collected": gc.get_threshold(),
    }


def test_a_process_is_given_back_as_it_was_and_runs_again(tmp_path: Path) -> None:
    torch.set_num_threads(2)
    torch.manual_seed(5)
    own = logging.FileHandler(tmp_path / "own.log", mode="w")
    logging.getLogger().addHandler(own)
    logging.getLogger().setLevel(logging.WARNING)
    before, frozen = state(), gc.get_freeze_count()
    first = run(*QUICK, "case=small")
    assert state() == before
    assert gc.get_freeze_count() <= frozen  # what other tests froze may have gone
    assert first.directory.parts[-3:-1] == ("outputs", "small")  # where the command puts them
    assert run(f"resume={first.directory}").directory == first.directory
    second = run(*QUICK, "case=small", directory="second")
    assert state() == before
    assert refused("system.ndof=-1") == "system.ndof=-1: must be a whole number >= 1"
    assert state() == before
    assert (first.directory / "parameters.csv").read_bytes() == (second.directory / "parameters.csv").read_bytes()
    logging.getLogger("mine").warning("heard")
    assert (tmp_path / "own.log").read_text() == "heard\n"  # the file is open, and has nothing of ours
    assert "estimate:" in (first.directory / "pinn-run.log").read_text()


def test_within_hydra_of_one_s_own_from_a_running_event_loop_and_from_another_thread_at_once() -> None:
    async def cell() -> tuple[Result, Result]:
        there = asyncio.get_running_loop().run_in_executor(None, lambda: run(*QUICK, keep=False))
        return run(*QUICK, keep=False), await there

    with initialize_config_module("pinn_cli.conf", version_base="1.2"):
        here, there = asyncio.run(cell())
        assert compose("config").seed == 0
    assert here.parameters.equals(there.parameters)
    # What is not kept goes with its object.
    place = here.directory
    assert place.is_dir()
    assert not Path("outputs").exists()
    del here
    assert not place.parent.exists()


def test_a_sweep_returns_its_runs(capfd: pytest.CaptureFixture[str]) -> None:
    sweep = run(*QUICK, "noise.snr_db=40,-2000", multirun=True)
    assert len(sweep) == 1
    assert list(sweep.jobs["status"]) == ["finished", "failed"]
    assert sweep[0].verdict is not None
    assert sweep.parameters["noise.snr_db"].unique().tolist() == [40]
    assert "-2000" in sweep.jobs["reason"][1]
    assert load(sweep.directory).fitness.equals(sweep.fitness)
    assert capfd.readouterr().out == ""
    assert "noise.snr_db=-2000: must be" in refused(*QUICK, "noise.snr_db=-2000,-3000", multirun=True)


@pytest.mark.parametrize(
    ("overrides", "given", "told"),
    [
        (("system.ndfo=3",), {}, "system.ndfo"),
        (("system.ndof=[1",), {}, "system.ndof=[1"),
        (("nonsense",), {}, "of the form setting=value"),
        (("--multirun", "seed=0,1"), {}, "multirun=True"),
        (("seed=0,1",), {}, "seed"),
        (("collect=outputs",), {}, "pinn_cli.load"),
        (("hydra.run.dir=here",), {}, "directory=..."),
        ((), {"directory": "here", "keep": False}, "keep=False"),
        (("resume=nowhere",), {}, "there is no such directory"),
        ((3,), {}, "a string"),
    ],
)
def test_errors_are_the_command_s_one_line(overrides: tuple[str, ...], given: dict[str, object], told: str) -> None:
    assert told in refused(*overrides, **given)


@pytest.mark.parametrize("error", [DivergenceError("far"), NotSoundError("doubtful"), ZeroDivisionError("a defect")])
def test_other_ends_of_a_run(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def job(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("pinn_cli.api.run.run_job", job)
    with pytest.raises(type(error), match=str(error)):
        run(*QUICK)


def test_an_interruption_ends_the_run_and_a_second_one_not_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    def job(*_: object, **__: object) -> None:
        with deferred():  # as in a step of a training
            os.kill(os.getpid(), signal.SIGINT)
            os.kill(os.getpid(), signal.SIGINT)
            steps.append(asked())
        steps.append("not reached")

    steps: list[object] = []
    monkeypatch.setattr("pinn_cli.api.run.run_job", job)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            run(*QUICK)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert steps == [True]


SENSORS = ("a1", "a2", "a3")


@pytest.fixture(scope="module")
def building() -> pd.DataFrame:
    a = of_building(0).outputs[:10_000]
    return pd.DataFrame({"t": np.arange(len(a)) / 50.0, **dict(zip(SENSORS, a.T, strict=True))})


def test_a_file_a_frame_and_the_command_are_one_look(building: pd.DataFrame, pinn_run: PinnRun) -> None:
    building.to_csv("rig.csv", index=False, float_format="%.17g")
    of_file, of_frame = inspect("rig.csv"), inspect(building)
    assert [file.name for file in Path().iterdir()] == ["rig.csv"]
    outcome = pinn_run("inspect", "rig.csv", "figures=false")
    assert outcome.out.partition("To estimate")[0] == of_file.text().partition("To estimate")[0]
    for name, table in of_file.tables.items():
        texts = [column for column in table if pd.api.types.is_string_dtype(table[column])]
        written = pd.read_csv(outcome.directory / f"{name}.csv", dtype=dict.fromkeys(texts, str))
        written[texts] = written[texts].fillna("")
        pd.testing.assert_frame_equal(written, table, check_dtype=False, rtol=1e-8)
        pd.testing.assert_frame_equal(of_frame.tables[name], table)
    assert of_file.command.startswith("pinn-run data=csv data.path=rig.csv 'data.acceleration={1: a1, 2: a2, 3: a3}'")
    assert of_file.settings[:2] == ("data=csv", "data.path=rig.csv")
    assert of_frame.settings[:2] == ("data.time='t'", "data.acceleration={1: a1, 2: a2, 3: a3}")
    assert of_frame.settings[2:] == of_file.settings[3:]
    assert "run(\"data.time='t'\", 'data.acceleration=" in of_frame.text()
    assert of_frame.figure().axes


def test_modes_of_several_frames_written_on_request(building: pd.DataFrame) -> None:
    pytest.importorskip("openpyxl")
    named = building.rename(columns={name: f"acceleration.{name[1]}" for name in SENSORS})
    found = modes([named, named.iloc[:8000]], "figures=false", directory="there")
    assert found.modes["records"].tolist() == ["1 2", "1 2", "1 2"]
    assert found.tables["modes_of_records"]["record"].tolist() == [1, 1, 1, 2, 2, 2]
    np.testing.assert_allclose(found.modes["frequency"][:3], BUILDING.frequency, rtol=0.01)
    assert {file.name for file in Path("there").iterdir()} >= {"modes.csv", "mac.csv", "spectra.csv", "pinn-run.log"}
    sheets = pd.read_excel(found.to_excel("modes.xlsx"), sheet_name=None)
    assert list(sheets) == ["modes", "mac", "modes_of_records", "spectra"]
    np.testing.assert_allclose(sheets["modes"]["frequency"], found.modes["frequency"], rtol=1e-14)


def test_a_record_whose_dofs_have_names() -> None:
    link = {"between": ["ground", "roof"], "law": "linear", "c": 5.0, "k": 4e3}
    time = np.arange(1000) / 50.0
    record = Structure.connected(["roof"], 10.0, {"column": link}).simulate(time, {"roof": np.sin(9.0 * time**1.5)})
    found = inspect(record)
    assert isinstance(record, Record)
    assert "acceleration of DOF 1" in found.channels["channel"].tolist()


def test_what_cannot_be_looked_at(building: pd.DataFrame) -> None:
    for data, overrides, told in (
        ("none.csv", (), "data.path=none.csv: must be a file that exists"),
        (["a.csv", "b.csv"], (), "must be the path of one file, or frames"),
        (building, ("data=csv",), "the record is in memory"),
        (building, ("hydra.run.dir=x",), r"left out of inspect\(...\)"),
        (building.iloc[:5], (), "5 samples"),
    ):
        with pytest.raises(InputError, match=told):
            inspect(data, *overrides)
    with pytest.raises(InputError, match="figure=stabilization: must be one of stabilisation, shapes; did you mean"):
        modes(building).figure("stabilization")
    assert not list(Path().iterdir())
