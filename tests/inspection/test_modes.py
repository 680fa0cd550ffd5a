"""Tables of modes of records, beside each other and a structure's; and the command ``modes``."""

import numpy as np
import pandas as pd
import pytest
from vibrating_records import BUILDING, Measured, of_building, of_building_with_machines, of_hammer, of_multisine

from pinn_cli.inspection.mode_report import ModesReport, mode_table
from pinn_cli.inspection.modes import ModalRecord, mac_table
from pinn_cli.record.signal import Signal


def recorded(record: Measured, places: tuple[int, ...] = (1, 2, 3)) -> ModalRecord:
    time = np.arange(len(record.outputs)) / record.rate
    sensors = [Signal(f"s{p}", a, "acceleration", str(p)) for p, a in zip(places, record.outputs.T, strict=True)]
    return ModalRecord.of([*sensors, *(Signal("f", f, "force", "1") for f in record.inputs.T)], time)


@pytest.fixture(scope="module")
def building() -> ModalRecord:
    return recorded(of_building(0))


def test_a_table_of_modes(building):
    table = mode_table(building, None)
    assert table["mode"].tolist() == [1, 2, 3]
    np.testing.assert_allclose(table["frequency"], BUILDING.frequency, rtol=5e-3)
    assert (table["lower_90"] < table["frequency"]).all()
    assert (table["upper_90"] > table["frequency"]).all()
    assert table[["mac", "prescribed_frequency"]].isna().all().all()
    np.testing.assert_allclose(table["fdd_frequency"], BUILDING.frequency, rtol=0.02)
    assert (table["fdd_mac"] > 0.98).all()
    shapes = table[["shape_1", "shape_2", "shape_3"]].to_numpy()
    np.testing.assert_allclose(np.abs(shapes).max(axis=1), 1.0)
    expected = BUILDING.shapes.T / BUILDING.shapes.T[np.arange(3), np.abs(shapes).argmax(axis=1)][:, None]
    np.testing.assert_allclose(shapes, expected, atol=0.05)
    assert (table["shape_1_lower_90"] <= table["shape_1"]).all()


def test_displacements_and_accelerations_have_one_shape():
    """The displacement of one of three floors, in place of its acceleration."""
    record = of_building(0)
    spectrum, omega = np.fft.rfft(record.outputs[:, 2]), 2.0 * np.pi * np.fft.rfftfreq(30_000, 0.02)
    moved = np.fft.irfft(np.where(omega > 5.0, -spectrum / np.maximum(omega, 5.0) ** 2, 0.0), 30_000)
    sensors = [Signal(f"a{i + 1}", record.outputs[:, i], "acceleration", str(i + 1)) for i in range(2)]
    mixed = ModalRecord.of([*sensors, Signal("u", moved, "displacement", "3")], np.arange(30_000) / 50.0)
    np.testing.assert_allclose(mixed.shapes.real, recorded(record).shapes.real, atol=0.1)


@pytest.mark.slow
def test_records_beside_each_other(building):
    other = recorded(Measured(of_building(1).outputs[:, :2], np.zeros((30_000, 0)), 50.0, BUILDING), (1, 2))
    table = mac_table([building, other])
    assert table["record"].tolist() == [1, 1, 1, 2, 2, 2]
    np.testing.assert_allclose(np.diag(table.iloc[:, 3:]), 1.0)
    np.testing.assert_allclose([table.loc[i, f"record_2_mode_{i + 1}"] for i in range(3)], 1.0, atol=0.02)
    elsewhere = recorded(Measured(of_building(1).outputs[:, :1], np.zeros((30_000, 0)), 50.0, BUILDING), (1,))
    assert mac_table([building, elsewhere])["record_2_mode_1"].isna().all()


@pytest.mark.parametrize("make", [of_hammer, of_multisine])
def test_what_is_written_of_forced_records(make, tmp_path):
    record = make(0)
    found = ModesReport([recorded(record)], None)
    found.write(tmp_path)
    assert "what acts: force of DOF 1" in found.text()
    assert len(pd.read_csv(tmp_path / "modes.csv")) == len(record.structure.frequency)
    assert (tmp_path / "figures" / "stabilisation.png").stat().st_size > 10_000


def test_machines_are_named():
    text = ModesReport([recorded(of_building_with_machines(1))], None).text()
    assert "steady lines at 1, 2, 4.1, 7.3, " in text


def test_the_command(pinn_run, tmp_path):
    for i in range(2):
        a = of_building(i).outputs[:10_000]
        pd.DataFrame({"t": np.arange(len(a)) / 50.0, **{f"a{j + 1}": a[:, j] for j in range(3)}}).to_csv(
            tmp_path / f"{i}.csv", index=False
        )
    structure = ["system=linear", "system.ndof=3", "system.m=1", "system.c=0.1", "system.k=[287,287,315.7]"]
    outcome = pinn_run(
        "modes", "data=csv", "data.records=[{path: 0.csv}, {path: 1.csv}]", "data.acceleration={1: a1, 2: a2, 3: a3}",
        *structure,
    )  # fmt: skip
    assert outcome.status == 0
    assert "MAC between records" in outcome.out
    assert pd.read_csv(outcome.directory / "modes_of_records.csv")["record"].tolist() == [1, 1, 1, 2, 2, 2]
    table = pd.read_csv(outcome.directory / "modes.csv")
    assert table["records"].tolist() == ["1 2"] * 3
    np.testing.assert_allclose(table["prescribed_frequency"], table["frequency"], rtol=0.02)
    assert (table["mac"] > 0.95).all()
    assert {p.name for p in outcome.directory.iterdir()} >= {
        "modes.csv", "mac.csv", "spectra.csv", "figures", ".hydra",
    }  # fmt: skip
    assert pd.read_csv(outcome.directory / "spectra.csv")["record"].unique().tolist() == [1, 2]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["modes"], "data=simulated: must be csv or another format of files with modes"),
        (["modes", "data=csv", "data.path=no.csv"], "must be a file that exists"),
        (["modes", "data=csv", "data.records=[{path: no.csv}, {path: b.csv}]"], "record 1: data.path"),
        (["modes", "resume=auto"], "resume=auto: must be left out with modes"),
        (["modes", "data=csv", "data.path=force.csv", "data.force={1: f}"], "a record with a sensor of the motion"),
        (["modes", "data=csv", "data.path=short.csv"], "data.start, data.stop=5 samples"),
    ],
)
def test_modes_that_cannot_be_had(pinn_run, tmp_path, arguments, expected):
    random = np.random.default_rng(0)
    pd.DataFrame({"t": np.arange(500) / 50.0, "f": random.normal(size=500)}).to_csv(tmp_path / "force.csv", index=False)
    pd.DataFrame({"t": np.arange(5) / 50.0, "a1": np.arange(5.0)}).to_csv(tmp_path / "short.csv", index=False)
    outcome = pinn_run(*arguments)
    assert outcome.status == 2
    assert expected in outcome.err
    assert outcome.err.count("\n") == 1
    assert not list(tmp_path.glob("outputs/*/*"))
