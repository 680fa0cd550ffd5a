"""Several files on one clock."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from refusals import refusal

from pinn_cli.record.clock import MeasuredFiles
from pinn_cli.record.files.csv import CsvFormat
from pinn_cli.record.files.table import Table
from pinn_cli.record.files.variables import joined
from pinn_cli.record.measured_data import MeasuredData

TIME = np.arange(64) / 128.0


@pytest.fixture
def folder(tmp_path) -> Path:
    pd.DataFrame({"t": TIME, "f": np.sin(TIME), "note": "x"}).to_csv(tmp_path / "force.csv", index=False)
    pd.DataFrame({"t": 1e3 * TIME, "a": np.cos(TIME), "note": "y"}).to_csv(tmp_path / "roof.csv", index=False)
    return tmp_path


def read(folder: Path, *names: str, **settings) -> MeasuredFiles:
    return MeasuredFiles(tuple(folder / name for name in names), CsvFormat(), **settings)


def measured(folder: Path, *names: str, **settings):
    return MeasuredData(list(names), None, {1: "f"}, acceleration={1: "a"}, base=folder, **settings).measure(1).record


def test_a_record_of_two_files(folder):
    pd.DataFrame({"t": TIME, "a": np.cos(TIME)}).to_csv(folder / "roof.csv", index=False)
    record = measured(folder, "force.csv", "roof.csv", start=0.1)
    np.testing.assert_allclose(record.time, TIME[13:])
    np.testing.assert_array_equal(record.force[:, 0], np.sin(TIME)[13:])
    np.testing.assert_array_equal(record.acceleration[:, 0], np.cos(TIME)[13:])


def test_a_file_of_another_rate_is_empty_between_its_samples(folder):
    slow = TIME[::4] + 1e-7  # printed by another logger
    pd.DataFrame({"t": slow, "a": np.cos(slow)}).to_csv(folder / "slow.csv", index=False)
    clock = read(folder, "force.csv", "slow.csv").read({"data.force.1": "f", "data.acceleration.1": "a"})
    np.testing.assert_allclose(clock.time, TIME, atol=1e-6)
    np.testing.assert_array_equal(clock.table.columns["a"][::4], np.cos(slow))
    assert np.isnan(clock.table.columns["a"]).sum() == 48
    (channel,) = measured(folder, "force.csv", "slow.csv").calibrated
    np.testing.assert_array_equal(channel.measured, np.cos(slow))


def test_errors_name_the_file_that_a_cell_comes_from(folder):
    (folder / "odd.csv").write_text("t,a\n" + "".join(f"{t},{'x' if i == 40 else i}\n" for i, t in enumerate(TIME)))
    told = refusal(measured, folder, "force.csv", "odd.csv")
    assert told.startswith("odd.csv, column 'a', line 42='x': must be a finite number")


def test_files_that_do_not_belong_together(folder):
    late = pd.DataFrame({"t": TIME + 100.0, "a": np.cos(TIME)})
    late.to_csv(folder / "late.csv", index=False)
    told = refusal(measured, folder, "force.csv", "late.csv")
    assert told.startswith("data.path=force.csv from 0 to 0.4921875 s, late.csv from 100 to 100.492188 s: must be rec")
    late.rename(columns={"a": "f"}).to_csv(folder / "late.csv", index=False)
    told = refusal(measured, folder, "force.csv", "late.csv")
    assert told.startswith("data.acceleration.1='a'")
    pd.DataFrame({"t": TIME, "a": TIME, "f": TIME}).to_csv(folder / "roof.csv", index=False)
    told = refusal(measured, folder, "force.csv", "roof.csv")
    assert "must be files whose columns have different names; 'f' is in both" in told
    assert "data.path=[]: must be given" in refusal(measured, folder)


def test_times_in_order_and_once():
    tables = [Table(Path("a"), {"a": np.arange(4.0)}), Table(Path("b"), {"b": np.arange(3.0)})]
    both = joined(tables, [np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.5, 1.004, 2.5])])
    np.testing.assert_allclose(both.time, [0.0, 0.5, 1.0, 2.0, 2.5, 3.0])
    np.testing.assert_array_equal(both.columns["a"], [0, np.nan, 1, 2, np.nan, 3])
    np.testing.assert_array_equal(both.columns["b"], [np.nan, 0, 1, np.nan, 2, np.nan])
