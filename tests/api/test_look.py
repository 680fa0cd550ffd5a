"""`inspect` and `modes` of Python find what the commands find, and leave nothing that nobody has asked for."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import PinnRun
from vibrating_records import BUILDING, of_building

from pinn_cli import InputError, Record, Structure, inspect, modes

SENSORS = ("a1", "a2", "a3")


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


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
        (None, (), "must be csv or another format of files with inspect"),
        (building, ("resume=auto",), "resume=auto: must be left out with inspect"),
        (building, ("data=csv",), "the record is in memory"),
        (building, ("hydra.run.dir=x",), r"left out of inspect\(...\)"),
        (building.iloc[:5], (), "5 samples"),
    ):
        with pytest.raises(InputError, match=told):
            inspect(data, *overrides)
    with pytest.raises(InputError, match="figure=stabilization: must be one of stabilisation, shapes; did you mean"):
        modes(building).figure("stabilization")
    assert not list(Path().iterdir())
