"""Windows of a record that is still being measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.windows import GrowingWindows, Patience
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear

STEP, CHAIN = 0.1, build_chain(1, Linear(), m=1.0, c=0.1, k=10.0)


class Rig:
    """It measures while the program sleeps, so many samples at a time, until it has them all."""

    def __init__(self, path: Path, samples: int, at_once: int) -> None:
        self.path, self.samples, self.at_once, self.written, self.clock = path, samples, at_once, 0, 0.0
        path.write_text("t,a\n")

    def sleep(self, seconds: float) -> None:
        self.clock += seconds
        stop = min(self.written + self.at_once, self.samples)
        with self.path.open("a") as file:
            file.writelines(f"{STEP * i:.3f},{np.sin(i):.9f}\n" for i in range(self.written, stop))
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
