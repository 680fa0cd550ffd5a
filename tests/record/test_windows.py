"""Where the windows of a record begin and end, and what has come of one that is still being measured."""

import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pinn_cli.record.arriving import Arriving
from pinn_cli.record.clock import MeasuredFiles
from pinn_cli.record.files.csv import CsvFormat
from pinn_cli.record.files.mat import MatFormat
from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.windows import Grid, GrowingWindows, Patience, Window, checked_lengths
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear

STEP = 0.02


def windows(duration: float, length: float, overlap: float | None, first: float = 0.0) -> list[Window]:
    time = first + np.arange(round(duration / STEP) + 1) * STEP
    return Grid.of(length, overlap, time).all(float(time[-1]))


def test_windows_hand_over_where_the_next_one_begins():
    found = windows(30.0, 12.0, 2.0, first=5.0)
    np.testing.assert_allclose([(w.start, w.stop) for w in found], [(5.0, 17.0), (15.0, 27.0), (25.0, 35.0)])
    assert [w.hand_over for w in found] == [pytest.approx(15.0), pytest.approx(25.0), None]
    assert found[1].name == "window 2 (15 to 27 s)"
    found = windows(22.0, 12.0, 2.0)  # the record ends with a window
    np.testing.assert_allclose([(w.start, w.stop) for w in found], [(0.0, 12.0), (10.0, 22.0)])
    assert [w.hand_over for w in found] == [pytest.approx(10.0), None]
    assert windows(5.0, 12.0, 2.0) == [Window(1, 0.0, 5.0)]
    grid = Grid.of(12.0, None, np.round(np.arange(4000) / 30.0, 3))  # whose median step of 0.033 s is 1 % off
    assert (grid.step, grid.overlap) == (pytest.approx(1.0 / 30.0, rel=1e-4), 60)
    assert not grid.is_reached(grid.window(1), 12.0 - grid.step)
    assert grid.is_reached(grid.window(1), 12.0 - 1e-9)


def test_what_is_too_little_for_a_window_is_left_out():
    """Without an overlap ten samples are left; with one they are in a window of their own."""
    np.testing.assert_allclose([w.stop for w in windows(24.2, 12.0, 0.0)], [12.0, 24.0])
    np.testing.assert_allclose([w.stop for w in windows(24.2, 12.0, 2.0)], [12.0, 22.0, 24.2])


@pytest.mark.parametrize(
    ("window", "overlap", "told"),
    [
        (0, None, "data.window=0"),
        (0.2, 0.0, "data.window=0.2"),
        ("a", None, "data.window"),
        (10, 6, "data.overlap=6"),
        (10, -1, "data.overlap=-1"),
    ],
)
def test_lengths_that_are_none(window, overlap, told):
    with pytest.raises(InputError, match=told):
        windows(30.0, *checked_lengths(window, overlap))


@pytest.mark.parametrize("setting", ["poll", "until_idle"])
def test_patience_is_a_number_of_seconds(setting):
    with pytest.raises(InputError, match=f"follow.{setting}=0"):
        Patience(**{setting: 0})


SAMPLING, CHAIN = 0.1, build_chain(1, Linear(), m=1.0, c=0.1, k=10.0)


class Rig:
    """It measures while the program sleeps, so many samples at a time, until it has them all."""

    def __init__(self, path: Path, samples: int, at_once: int) -> None:
        self.path, self.samples, self.at_once, self.written, self.clock = path, samples, at_once, 0, 0.0
        path.write_text("t,a\n")

    def sleep(self, seconds: float) -> None:
        self.clock += seconds
        stop = min(self.written + self.at_once, self.samples)
        with self.path.open("a") as file:
            file.writelines(f"{SAMPLING * i:.3f},{np.sin(i):.9f}\n" for i in range(self.written, stop))
        self.written = stop

    def windows(self, **more) -> GrowingWindows:
        data = MeasuredData(str(self.path), acceleration={1: "a"}, base=self.path.parent, **more)
        return GrowingWindows(data, [], 10.0, 2.0, Patience(1.0, 5.0), self.sleep, lambda: self.clock)


def followed(windows: GrowingWindows, done: int = 0) -> list[tuple[int, float, float, np.ndarray]]:
    out = []
    for window in windows.after(done):
        record = windows.measure(CHAIN, window).record
        out.append((window.number, float(record.time[0]), float(record.time[-1]), record.acceleration[:, 0]))
    return out


@pytest.mark.parametrize("at_once", [7, 60, 1000])
def test_each_is_there_once_and_the_same_however_it_grows(tmp_path, at_once):
    rig = Rig(tmp_path / "a.csv", 263, at_once)
    found = followed(rig.windows())
    assert [(n, pytest.approx(a), pytest.approx(b)) for n, a, b, _ in found] == [
        (1, 0.0, 10.0), (2, 8.0, 18.0), (3, 16.0, 26.0), (4, 24.0, 26.2),
    ]  # fmt: skip
    for number, _, _, values in found:
        first = 80 * (number - 1)
        np.testing.assert_allclose(values, np.sin(np.arange(first, first + len(values))), atol=1e-8)
    windows = rig.windows()
    later = followed(windows, done=2)  # it goes on with the next one
    assert [n for n, *_ in later] == [3, 4]
    np.testing.assert_array_equal(found[2][3], later[0][3])
    assert len(windows.arriving.time) < 30  # what stands before a window is forgotten


def test_it_ends_where_data_stop_says(tmp_path):
    rig = Rig(tmp_path / "a.csv", 100_000, 50)
    found = followed(rig.windows(start=3.0, stop=20.0))
    assert [(n, pytest.approx(a), pytest.approx(b)) for n, a, b, _ in found] == [(1, 3.0, 13.0), (2, 11.0, 20.0)]
    assert rig.written < 400
    rig = Rig(tmp_path / "b.csv", 0, 1)
    with pytest.raises(InputError, match="nothing has come"):
        followed(rig.windows())
    assert rig.clock == 5.0


WANTED = {"data.acceleration.1": "a"}


def arriving(path: Path, **more) -> Arriving:
    return Arriving(MeasuredFiles((path,), more.pop("format", CsvFormat()), **more), WANTED)


def rows(first: int, stop: int, start: float = 0.0) -> str:
    return "".join(f"{start + 0.1 * (i - first):.6g},{i}.5,other\n" for i in range(first, stop))


def append(path: Path, text: str) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write(text)


def test_a_line_that_is_still_being_written_is_not_read(tmp_path):
    """3.5 cut off is 3, a number as good as any."""
    path = tmp_path / "a.csv"
    came = arriving(path)
    append(path, "t,a,note\n" + rows(0, 6) + "0.6,6")
    assert came.read()
    np.testing.assert_array_equal(came.table.columns["a"], np.arange(6) + 0.5)
    assert not came.read()
    append(path, ".5,other\n0.7,7.5,oth")
    assert came.read()
    np.testing.assert_array_equal(came.table.columns["a"], np.arange(7) + 0.5)
    np.testing.assert_allclose(came.time, 0.1 * np.arange(7))


def test_however_it_comes_it_is_the_same(tmp_path):
    whole = "t;a [g];note\ns;g;\n" + "".join(f"{0.1 * i:.3f};{i},25;x\n".replace(".", ",") for i in range(40))
    one, other = tmp_path / "one.csv", tmp_path / "other.csv"
    one.write_text(whole)
    asked = {"data.acceleration.1": "a [g]"}
    at_once, bit_by_bit = (Arriving(MeasuredFiles((p,), CsvFormat()), asked) for p in (one, other))
    at_once.read()
    rng = np.random.default_rng(1)
    cuts = [0, *sorted(rng.integers(90, len(whole), 12).tolist()), len(whole)]
    for first, stop in pairwise(cuts):
        append(other, whole[first:stop])
        bit_by_bit.read()
    for name, values in at_once.table.columns.items():
        np.testing.assert_array_equal(values, bit_by_bit.table.columns[name])
    np.testing.assert_array_equal(at_once.time, bit_by_bit.time)
    assert at_once.table.hints == bit_by_bit.table.hints
    assert at_once.table.columns["a [g]"][3] == 3.25


def test_what_is_forgotten_leaves_the_rest_as_it_was(tmp_path):
    path = tmp_path / "a.csv"
    append(path, "t,a,note\n" + rows(0, 30) + "3.0,wrong,x\n")
    came = arriving(path)
    came.read()
    came.forget_before(0.95)
    np.testing.assert_allclose(came.time[[0, -1]], [1.0, 3.0])
    assert came.table.columns["a"][0] == 10.5
    with pytest.raises(InputError, match="wrong"):
        came.table.numbers("a")
    path.write_text("t,a,note\n" + rows(0, 3))
    with pytest.raises(InputError, match="shorter than it was"):
        came.read()
    path.write_text("t,b,note\n" + rows(0, 6))
    with pytest.raises(InputError, match=r"data.acceleration.1='a'"):
        arriving(path).read()


def test_dates_count_from_the_first_and_marks_are_gaps(tmp_path):
    came, path = arriving(tmp_path / "a.csv", missing=-5), tmp_path / "a.csv"
    append(path, "t,a\n" + "".join(f"170000000{i}.5,{i}.5\n" for i in range(6)))
    came.read()
    append(path, "1700000006.5,-5\n1700000007.5,7.5\n")
    came.read()
    np.testing.assert_array_equal(came.clock.time, np.arange(8.0))
    assert np.flatnonzero(np.isnan(came.table.columns["a"])).tolist() == [6]


def test_files_of_a_folder_in_the_order_of_their_names(tmp_path):
    """The clock of the second begins anew, that of the third goes on; what is no record is passed over."""
    came = arriving(tmp_path)
    append(tmp_path / "001.csv", "t,a,note\n" + rows(0, 10, start=5.0))
    (tmp_path / "notes.md").write_text("t,a\n")
    (tmp_path / ".003.csv").write_text("t,a\n")
    assert came.read()
    append(tmp_path / "002.csv", "t,a,note\n" + rows(10, 20))
    append(tmp_path / "003.csv", "t,a,note\n" + rows(20, 30, start=7.0) + "7.99")
    assert came.read()
    np.testing.assert_allclose(came.time, 5.0 + 0.1 * np.arange(30))
    np.testing.assert_array_equal(came.table.columns["a"], np.arange(30) + 0.5)
    (tmp_path / "0025.csv").write_text("t,a,note\n" + rows(0, 9))
    with pytest.raises(InputError, match=r"0025.csv.*order of their names"):
        came.read()


def test_samples_at_a_rate_are_counted_on_from_file_to_file(tmp_path):
    came = arriving(tmp_path, sampling_rate=10.0)
    for number in range(3):
        append(tmp_path / f"{number}.csv", "a\n" + "".join(f"{i}.5\n" for i in range(10 * number, 10 * number + 10)))
        assert came.read()
    np.testing.assert_allclose(came.time, 0.1 * np.arange(30))


def test_a_file_that_is_read_as_a_whole(tmp_path):
    """While it is being written it may not be readable; what stays unreadable is an error."""
    from scipy.io import savemat

    path = tmp_path / "a.mat"
    came = arriving(path, format=MatFormat())

    def save(samples: int) -> None:
        savemat(tmp_path / "new", {"t": 0.1 * np.arange(samples), "a": np.arange(samples) + 0.5}, appendmat=False)
        os.replace(tmp_path / "new", path)

    save(10)
    assert came.read()
    assert not came.read()
    save(15)
    assert came.read()
    np.testing.assert_array_equal(came.table.columns["a"], np.arange(15) + 0.5)
    path.write_bytes(b"half")
    assert not came.read()
    with pytest.raises(InputError, match="a.mat"):
        came.read()
