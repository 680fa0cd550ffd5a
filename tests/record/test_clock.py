"""When samples were taken: a column, a sampling rate, the file's own header; and several files on one clock."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import refusal

from pinn_cli.record.clock import MeasuredFiles
from pinn_cli.record.files.csv import CsvFormat
from pinn_cli.record.files.file_format import FileFormat
from pinn_cli.record.files.table import Table
from pinn_cli.record.files.variables import joined
from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.settings.errors import InputError

ROWS = 60
SETTINGS = {"path": "rig.csv", "force": {1: "f"}, "acceleration": {1: "a"}}


def table(step: float = 0.01) -> pd.DataFrame:
    rows = np.arange(ROWS)
    return pd.DataFrame({"t": np.round(step * rows, 6), "f": np.sin(rows), "a": np.cos(rows)})


def read(base: Path, **changes):
    return MeasuredData(**{**SETTINGS, "base": base, **changes}).measure(1).record


class Header(FileFormat):
    """A format whose header tells times, as far as ``time`` is given."""

    name, suffixes, tells_time = "header", (".header",), True

    def __init__(self, time: np.ndarray | None) -> None:
        self.time = time

    def read(self, path, wanted=None):
        frame = table()
        names = frame.columns if wanted is None else wanted.values()
        return Table(path, {name: frame[name].to_numpy() for name in names}, time=self.time)


@pytest.mark.parametrize("per_second", [1.0, 1e3, 1e6, 1e9])
def test_times_since_1970_tell_their_unit(tmp_path, per_second):
    frame = table()
    frame["t"] = [f"{per_second * (1_773_359_990 + time):.{2 if per_second == 1 else 0}f}" for time in frame["t"]]
    frame.to_csv(tmp_path / "rig.csv", index=False)
    record = read(tmp_path)
    assert record.sampling_rate == pytest.approx(100.0, rel=1e-4)
    assert record.time[[0, -1]] == pytest.approx([0.0, 0.59], abs=1e-6)  # dates count from the first


@pytest.mark.parametrize(
    ("name", "per_second"),
    [("time", 1), ("Time [s]", 1), ("Zeit", 1), ("Time (ms)", 1e3), ("TIME_MS", 1e3),
     ("t_ns", 1e9), ("Zeit / s", 1), ("Time, µs", 1e6), ("Elapsed time ms", 1e3)],
)  # fmt: skip
def test_times_are_found_by_name_and_unit(tmp_path, name, per_second):
    times = per_second * table()["t"]
    frame = table().drop(columns="t").assign(T=20.0)
    frame.insert(2, name, times)
    frame.to_csv(tmp_path / "rig.csv", index=False)
    np.testing.assert_allclose(read(tmp_path).time, table()["t"], atol=1e-12)
    np.testing.assert_allclose(read(tmp_path, time_unit="us").time, 1e-6 * times, atol=1e-12)
    with pytest.raises(InputError, match="must be another column than data.time"):
        read(tmp_path, force={1: name})
    table().assign(time=times**2)[["time", "t", "f", "a"]].to_csv(tmp_path / "rig.csv", index=False)  # t goes first
    np.testing.assert_allclose(read(tmp_path).time, table()["t"], atol=1e-12)
    names, *lines = table().assign(t=10 * np.arange(ROWS)).to_csv(index=False).splitlines()
    (tmp_path / "rig.csv").write_text("\n".join([names, "ms,N,m/s^2", *lines]))  # a line of units
    np.testing.assert_allclose(read(tmp_path).time, table()["t"], atol=1e-12)


@pytest.mark.parametrize("zone", ["", "Z", "+02:00"])
def test_dates_count_from_the_first(tmp_path, zone):
    dates = pd.Timestamp("2026-03-01T23:59:59.5") + pd.to_timedelta(table()["t"], unit="s")
    frame = table().assign(t=[f"{date.isoformat(timespec='milliseconds')}{zone}" for date in dates])
    frame.to_csv(tmp_path / "rig.csv", index=False)
    np.testing.assert_allclose(read(tmp_path).time, table()["t"], atol=1e-9)


@pytest.mark.parametrize("jump", [3600.0, 1e9])
def test_a_clock_that_was_set_is_told_with_its_line(tmp_path, caplog, jump):
    rows = table()
    rows.loc[40:, "t"] += jump
    rows.to_csv(tmp_path / "rig.csv", index=False)
    with pytest.raises(InputError, match=r"line 42=.*near the line before it, 0\.39; was the clock set there\?"):
        read(tmp_path)
    assert len(read(tmp_path, stop=1.0).time) == 40
    rows.loc[40:, "t"] -= jump - 4.0  # a gap of nearly the record is no jump
    rows.to_csv(tmp_path / "rig.csv", index=False)
    assert read(tmp_path).time[-1] == pytest.approx(4.59)
    assert "times are uneven" in caplog.text


def test_a_sampling_rate_stands_in_place_of_times(tmp_path):
    table(0.001).round({"t": 2}).to_csv(tmp_path / "rig.csv", index=False)
    assert refusal(read, tmp_path).endswith("too few digits? Give data.sampling_rate, in Hz, instead")
    table().rename(columns={"t": "counter"}).to_csv(tmp_path / "rig.csv", index=False)
    assert "data.time='t': must be a column of rig.csv, which has 'counter', 'f', 'a'" in refusal(read, tmp_path)
    record = read(tmp_path, sampling_rate=610.35, start=0.02)
    assert record.sampling_rate == pytest.approx(610.35)
    assert record.time[0] == pytest.approx(13 / 610.35)
    np.testing.assert_array_equal(record.force[:, 0], table()["f"][13:])


def test_the_header_tells_times_unless_the_user_does(tmp_path):
    (tmp_path / "rig.header").touch()
    own = Header(5.0 + np.arange(ROWS) / 50.0)
    settings = {"path": "rig.header", "format": own}
    assert read(tmp_path, **settings).time[[0, -1]] == pytest.approx([5.0, 5.0 + 59 / 50.0])
    assert read(tmp_path, **settings, time="t").time[[0, -1]] == pytest.approx([0.0, 0.59])
    assert read(tmp_path, **settings, sampling_rate=10).time[[0, -1]] == pytest.approx([0.0, 5.9])
    with pytest.raises(InputError, match=r"data.sampling_rate=None: must be given, in Hz, or data.time.* rig.header"):
        read(tmp_path, path="rig.header", format=Header(None))


@pytest.mark.parametrize(
    ("expected", "changes"),
    [
        ("data.sampling_rate=0", {"sampling_rate": 0}),
        ("data.sampling_rate=100", {"sampling_rate": 100, "time": "t"}),
        ("data.time_unit=day", {"time_unit": "day"}),
        ("data.force.1='t'", {"force": {1: "t"}}),
    ],
)
def test_settings_of_the_clock_that_cannot_be_used(tmp_path, expected, changes):
    table().to_csv(tmp_path / "rig.csv", index=False)
    assert refusal(read, tmp_path, **changes).startswith(expected)


@pytest.mark.parametrize(
    ("pattern", "late"),
    [("%Y-%m-%dT%H:%M:%S.%f", "f"), ("%d.%m.%Y %H:%M:%S,%f", "f"), ("%d-%b-%Y %H:%M:%S.%f", "a"), ("%H:%M:%S.%f", "a")],
)
def test_dates_of_several_files_are_of_one_clock(tmp_path, pattern, late):
    """Two loggers were started one after the other, about midnight."""
    frame = table()
    dates = pd.Timestamp("2026-03-12 23:59:59.8") + pd.to_timedelta(frame["t"], unit="s")
    frame.insert(0, "Date", dates.dt.strftime(pattern))
    for column in ("f", "a"):
        frame[["Date", column]].iloc[20 if column == late else 0 :].to_csv(
            tmp_path / f"{column}.csv", sep=";", index=False
        )
    record = read(tmp_path, path=["f.csv", "a.csv"], start=0.195, stop=0.505)
    np.testing.assert_allclose(record.time, frame["t"][20:51], atol=1e-9)
    np.testing.assert_array_equal(record.acceleration[:, 0], frame["a"][20:51])
    np.testing.assert_array_equal(record.force[:, 0], frame["f"][20:51])


TIME = np.arange(64) / 128.0


@pytest.fixture
def folder(tmp_path) -> Path:
    pd.DataFrame({"t": TIME, "f": np.sin(TIME), "note": "x"}).to_csv(tmp_path / "force.csv", index=False)
    return tmp_path


def measured(folder: Path, *names: str, **settings):
    return MeasuredData(list(names), None, {1: "f"}, acceleration={1: "a"}, base=folder, **settings).measure(1).record


def test_a_file_of_another_rate_is_empty_between_its_samples(folder):
    slow = TIME[::4] + 1e-7  # printed by another logger
    pd.DataFrame({"t": slow, "a": np.cos(slow)}).to_csv(folder / "slow.csv", index=False)
    files = MeasuredFiles((folder / "force.csv", folder / "slow.csv"), CsvFormat())
    clock = files.read({"data.force.1": "f", "data.acceleration.1": "a"})
    np.testing.assert_allclose(clock.time, TIME, atol=1e-6)
    np.testing.assert_array_equal(clock.table.columns["a"][::4], np.cos(slow))
    assert np.isnan(clock.table.columns["a"]).sum() == 48
    (channel,) = measured(folder, "force.csv", "slow.csv").calibrated
    np.testing.assert_array_equal(channel.measured, np.cos(slow))
    pd.DataFrame({"t": TIME, "a": np.cos(TIME)}).to_csv(folder / "roof.csv", index=False)
    record = measured(folder, "force.csv", "roof.csv", start=0.1)  # of one rate
    np.testing.assert_allclose(record.time, TIME[13:])
    np.testing.assert_array_equal(record.force[:, 0], np.sin(TIME)[13:])
    np.testing.assert_array_equal(record.acceleration[:, 0], np.cos(TIME)[13:])


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
