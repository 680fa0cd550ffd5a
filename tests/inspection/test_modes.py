"""Modes of records, beside each other and a structure's, put together over sensors that rove; the command ``modes``."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from vibrating_records import (
    BUILDING,
    Measured,
    Vibrating,
    ambient,
    of_building,
    of_building_with_machines,
    of_hammer,
    of_multisine,
)

from pinn_cli.inspection.mode_report import ModesReport, mode_table
from pinn_cli.inspection.modes import JoinedModes, ModalRecord
from pinn_cli.record.identification.lines import RecordMode, normalised
from pinn_cli.record.identification.modes import Identified, assurance, stabilisation
from pinn_cli.record.signal import Sampling, Signal
from pinn_cli.system.priors import HALF_WIDTH_90


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


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (of_hammer, "what acts: force of DOF 1"),
        (of_multisine, "what acts: force of DOF 1"),
        (of_building_with_machines, "steady lines at 1, 2, 4.1, 7.3, "),
    ],
)
def test_what_is_written_of_a_record(make, told, tmp_path):
    record = make(0)
    found = ModesReport([recorded(record)], None)
    found.write(tmp_path)
    assert told in found.text()
    assert len(pd.read_csv(tmp_path / "modes.csv")) == len(record.structure.frequency)
    assert (tmp_path / "figures" / "stabilisation.png").stat().st_size > 10_000


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
    ).done()  # fmt: skip
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


TIME = np.arange(400) / 50.0
SETUPS = ((7, 5, 1, 2), (7, 5, 3, 4), (5, 6, 7))
SHAPES = np.array([[0.2, 0.5, 0.6, 0.8, 0.9, 0.95, 1.0], [0.5, 1.0, 0.4, -0.7, -0.9, -0.3, 0.8]])
STD = np.array([[1e-4, 1e-2], [1e-3, 0.1]])  # of a frequency and a damping ratio in a record, relative
TALL = Vibrating.chain(1.2, [1.0, 1.1, 1.0, 0.9, 1.0], [0.01, 0.012, 0.01, 0.015, 0.01])


def shown(
    random: np.random.Generator, places: Sequence[int], size: float = 0.02, frequencies: Sequence[float] = (1.2, 3.4)
) -> ModalRecord:
    """A record with two modes, whose errors are as large as it says."""
    modes = []
    for shape, f, std in zip(SHAPES[:, np.array(places) - 1], frequencies, STD, strict=True):
        error = size / 2**0.5 * (random.normal(size=len(places)) + 1j * random.normal(size=len(places)))
        scale = random.uniform(0.1, 9.0) * np.exp(1j * random.normal())
        seen, noise = normalised(scale * (shape + error), abs(scale) ** 2 * size**2 * np.eye(len(places)))
        off = np.exp(std * random.normal(size=2))
        modes.append(RecordMode(f * off[0], 0.01 * off[1], np.diag(std**2), seen, noise, 0.9))
    sensors = [Signal(f"a{p}", TIME, "acceleration", str(p)) for p in places]
    still = np.zeros((400, 1))
    return ModalRecord(sensors, [], Sampling(TIME), Identified(modes, [], stabilisation(still, still[:, :0], 0.02), []))


def test_shapes_of_all_places():
    joined = JoinedModes.of([shown(np.random.default_rng(0), places, 1e-3) for places in SETUPS])
    assert joined.names == ["1", "2", "3", "4", "5", "6", "7"]
    np.testing.assert_allclose(joined.shapes.real, SHAPES, atol=0.01)
    assert [[part.record for part in one.parts] for one in joined.joined] == [[0, 1, 2], [0, 1, 2]]
    assert not joined.unconnected


def test_intervals_of_joined_modes():
    """Of 40 times three records: 90 % intervals of shapes, frequencies and damping ratios hold 85 to 96 %."""
    random = np.random.default_rng(1)
    of_shapes, of_modes = [], []
    for _ in range(40):
        joined = JoinedModes.of([shown(random, places) for places in SETUPS])
        for i, one in enumerate(joined.joined):
            shape = one.mode.shape.real
            largest = int(np.argmax(np.abs(shape)))
            off = np.abs(shape - SHAPES[i] / SHAPES[i][largest]) < HALF_WIDTH_90 * one.shape_std
            of_shapes.append(np.delete(off, largest))
            true = (1.2, 3.4)[i], 0.01
            ends = one.mode.frequency_interval, one.mode.damping_interval
            of_modes.append([a < value < b for value, (a, b) in zip(true, ends, strict=True)])
    assert 0.85 < np.mean(of_shapes) < 0.96
    assert (np.abs(np.mean(of_modes, axis=0) - 0.92) < 0.06).all()


def test_one_record_is_a_list_of_one():
    record = shown(np.random.default_rng(0), SETUPS[0])
    joined = JoinedModes.of([record])
    order = [record.names.index(name) for name in joined.names]
    np.testing.assert_allclose(joined.shapes.real, record.shapes[:, order].real, atol=1e-9)
    np.testing.assert_allclose(joined.shape_std(0), record.shape_std(0)[order], atol=1e-3)
    np.testing.assert_allclose(joined.modes[0].covariance, record.modes[0].covariance)


def test_records_that_do_not_go_together(tmp_path):
    """A frequency that has moved, a gain and a sign that are wrong, and a record without a reference."""
    random = np.random.default_rng(2)
    weak, turned, other = shown(random, (5, 7, 1)), shown(random, (5, 7, 1)), shown(random, (2, 3))
    weak.modes[0].shape[1] *= 0.2
    turned.modes[1].shape[1] *= -1.0
    elsewhere = [replace(signal, place=place) for signal, place in zip(other.sensors, ("11", "12"), strict=True)]
    records = [shown(random, SETUPS[0]), shown(random, SETUPS[1], frequencies=(1.2, 3.47)), weak, turned,
               replace(other, sensors=elsewhere)]  # fmt: skip
    report = ModesReport(records, None)
    report.write(tmp_path, figures=False)
    text = " ".join(report.text().split())
    assert "frequencies differ beyond their intervals (3.4" in text
    assert "the shape of record 3 differs from that of all" in text
    assert "and another shape at common sensors (MAC 0." in text
    assert "record 5 has no sensor in common with those before it" in text
    table = pd.read_csv(tmp_path / "modes.csv")
    assert sorted(table["records"].astype(str)) == ["1 2 3", "1 2 3 4", "4", "5", "5"]
    moved = table[table["records"] == "1 2 3"].iloc[0]
    assert moved["frequency_agreement"] < 1e-6
    assert moved["upper_90"] - moved["lower_90"] > 0.05
    assert moved[["shape_11", "shape_12"]].isna().all()
    assert len(pd.read_csv(tmp_path / "modes_of_records.csv")) == 10


def test_a_reference_near_a_node_is_named():
    random = np.random.default_rng(0)
    records = [shown(random, (3, 1, 2)), shown(random, (3, 6, 7))]
    loose = [one.scale_std.max() for one in JoinedModes.of(records).joined]
    far = JoinedModes.of([shown(random, (2, 1, 3)), shown(random, (2, 6, 7))]).joined[1].scale_std.max()
    assert loose[1] > 0.03 > far


@pytest.fixture(scope="module")
def roving(tmp_path_factory) -> list[str]:
    """Files of three records of a tower: its top and third floor stay, another floor each."""
    folder, files = tmp_path_factory.mktemp("roving"), []
    for i, places in enumerate(((5, 3, 1), (5, 3, 2), (5, 3, 4))):
        a = (1.0 + i) * ambient(TALL, 240.0, 50.0, i)
        columns = {"t": np.arange(len(a)) / 50.0, **{f"floor_{p}": a[:, p - 1] for p in places}}
        files.append(str(folder / f"setup_{i + 1}.csv"))
        pd.DataFrame(columns).to_csv(files[-1], index=False)
    return files


@pytest.mark.slow
def test_files_of_sensors_that_rove(pinn_run, roving):
    """Files with a column in common are records of their own; the structure's modes are compared at all places."""
    columns = "data.acceleration={" + ", ".join(f"{p}: floor_{p}" for p in range(1, 6)) + "}"
    drift = np.eye(5) - np.eye(5, k=-1)
    w = (2.0 * np.pi * 1.2) ** 2 / np.linalg.eigvalsh(drift.T @ np.diag([1.0, 1.1, 1.0, 0.9, 1.0]) @ drift)[0]
    structure = ["system=linear", "system.ndof=5", "system.m=1", "system.c=0.1",
                 f"system.k=[{w},{1.1 * w},{w},{0.9 * w},{w}]"]  # fmt: skip
    outcome = pinn_run("modes", *roving, columns, *structure).done()
    assert "all records together" in outcome.out
    table = pd.read_csv(outcome.directory / "modes.csv")
    clear = table[table["records"] == "1 2 3"]
    assert len(clear) >= 4
    assert (clear["mac"] > 0.98).all()
    np.testing.assert_allclose(clear["frequency"], clear["prescribed_frequency"], rtol=0.01)
    names = [f"shape_{p}" for p in range(1, 6)]
    for (_, row), f in zip(clear.iterrows(), clear["frequency"], strict=True):
        true = TALL.shapes[:, np.argmin(np.abs(TALL.frequency - f))]
        assert assurance(row[names].to_numpy(float)[None], true[None])[0, 0] > 0.98
    assert (outcome.directory / "figures" / "shapes.png").stat().st_size > 10_000
