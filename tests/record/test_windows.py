"""Where the windows of a record begin and end, and what is in them."""

from __future__ import annotations

import numpy as np
import pytest

from pinn_cli.record.windows import Grid, Window, checked_lengths
from pinn_cli.settings.errors import InputError

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
