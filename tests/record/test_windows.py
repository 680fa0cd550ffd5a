"""Where the windows of a record begin and end, what is in them, and those of a record that is still being measured."""

from pathlib import Path

import numpy as np
import pytest

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


def test_a_record_that_ends_with_a_window():
    found = windows(22.0, 12.0, 2.0)
    np.testing.assert_allclose([(w.start, w.stop) for w in found], [(0.0, 12.0), (10.0, 22.0)])
    assert [w.hand_over for w in found] == [pytest.approx(10.0), None]


def test_a_record_shorter_than_a_window_is_one():
    assert windows(5.0, 12.0, 2.0) == [Window(1, 0.0, 5.0)]


def test_what_is_too_little_for_a_window_is_left_out():
    """Without an overlap ten samples are left; with one they are in a window of their own."""
    np.testing.assert_allclose([w.stop for w in windows(24.2, 12.0, 0.0)], [12.0, 24.0])
    np.testing.assert_allclose([w.stop for w in windows(24.2, 12.0, 2.0)], [12.0, 22.0, 24.2])


def test_an_overlap_that_nobody_gave():
    assert Grid.of(12.0, None, np.arange(1000) * STEP).overlap == round(2.0 / STEP)


def test_a_window_is_there_when_its_last_sample_is():
    grid = Grid(0.0, STEP, 600, 100)
    window = grid.window(1)
    assert not grid.is_reached(window, 12.0 - STEP)
    assert grid.is_reached(window, 12.0 - 1e-9)


@pytest.mark.parametrize(
    ("window", "overlap", "told"),
    [(0, None, "data.window=0"), ("a", None, "data.window"), (10, 6, "data.overlap=6"), (10, -1, "data.overlap=-1")],
)
def test_lengths_that_are_none(window, overlap, told):
    with pytest.raises(InputError, match=told):
        checked_lengths(window, overlap)


def test_windows_of_too_few_samples():
    with pytest.raises(InputError, match=r"data.window=0.2"):
        windows(30.0, 0.2, 0.0)


def test_times_that_are_printed_with_few_digits():
    """A median step of 0.033 s would put the end of the hundredth window three seconds off."""
    time = np.round(np.arange(4000) / 30.0, 3)
    assert Grid.of(12.0, 2.0, time).step == pytest.approx(1.0 / 30.0, rel=1e-4)


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


def test_it_goes_on_with_the_next_one(tmp_path):
    rig = Rig(tmp_path / "a.csv", 263, 1000)
    whole = followed(rig.windows())
    later = followed(rig.windows(), done=2)
    assert [n for n, *_ in later] == [3, 4]
    np.testing.assert_array_equal(whole[2][3], later[0][3])


def test_what_stands_before_a_window_is_forgotten(tmp_path):
    rig = Rig(tmp_path / "a.csv", 263, 1000)
    windows = rig.windows()
    followed(windows)
    assert len(windows.arriving.time) < 30


def test_it_ends_where_data_stop_says(tmp_path):
    rig = Rig(tmp_path / "a.csv", 100_000, 50)
    found = followed(rig.windows(start=3.0, stop=20.0))
    assert [(n, pytest.approx(a), pytest.approx(b)) for n, a, b, _ in found] == [(1, 3.0, 13.0), (2, 11.0, 20.0)]
    assert rig.written < 400


def test_nothing_comes(tmp_path):
    rig = Rig(tmp_path / "a.csv", 0, 1)
    with pytest.raises(InputError, match="nothing has come"):
        followed(rig.windows())
    assert rig.clock == 5.0


@pytest.mark.parametrize("setting", ["poll", "until_idle"])
def test_patience_is_a_number_of_seconds(setting):
    with pytest.raises(InputError, match=f"follow.{setting}=0"):
        Patience(**{setting: 0})
