"""A band of a record: what lies in it stays as it is, what lies outside is gone."""

from __future__ import annotations

import numpy as np
import pytest

from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.spectrum import BandPass
from pinn_cli.settings.errors import InputError

RATE, SECONDS = 100.0, 40.0
TIME = np.arange(round(RATE * SECONDS)) / RATE


def test_what_lies_in_the_band_stays_at_every_time_and_the_rest_is_gone() -> None:
    band = BandPass.of((4.0, 12.0), len(TIME), 1.0 / RATE)
    inside = np.sin(2 * np.pi * np.outer(TIME, [4.0, 7.3, 12.0]) + 0.3)
    outside = np.sin(2 * np.pi * np.outer(TIME, [1.0, 15.0, 30.0]))
    kept = slice(band.half, len(TIME) - band.half, band.factor)
    np.testing.assert_allclose(band.filtered(inside), inside[kept], atol=3e-3)
    assert np.abs(band.filtered(outside)).max() < 3e-3
    assert 0.5 * RATE / band.factor > 1.2 * 12.0
    assert band.factor > 1


def test_a_file_is_filtered_with_the_samples_beyond_the_window(tmp_path) -> None:
    values = np.column_stack((TIME, np.sin(2 * np.pi * 6.0 * TIME), 9.81 + np.cos(2 * np.pi * 6.0 * TIME)))
    path = tmp_path / "record.csv"
    np.savetxt(path, values, delimiter=",", header="t,f,a", comments="")
    given = {"force": {1: "f"}, "acceleration": {1: "a"}, "band": [4, 12]}
    part = MeasuredData(str(path), "t", start=10.0, stop=30.0, **given).measure(1).record
    assert part.band.edges == (4.0, 12.0)
    assert part.time[0] == pytest.approx(10.0)
    assert 29.9 < part.time[-1] <= 30.0 + 1e-9
    np.testing.assert_allclose(part.acceleration[:, 0], np.cos(2 * np.pi * 6.0 * part.time), atol=3e-3)
    whole = MeasuredData(str(path), "t", **given).measure(1).record
    assert 0.2 < whole.time[0] < 4.0
    assert TIME[-1] - 4.0 < whole.time[-1] < TIME[-1] - 0.2


@pytest.mark.parametrize(("band", "told"), [([12, 4], "grow"), (7, "two frequencies"), ([4, 60], "50 Hz")])
def test_a_band_that_is_none(tmp_path, band, told) -> None:
    path = tmp_path / "record.csv"
    np.savetxt(path, np.column_stack((TIME, TIME**2, TIME**3)), delimiter=",", header="t,f,a", comments="")
    with pytest.raises(InputError, match=r"data\.band") as refused:
        MeasuredData(str(path), "t", {1: "f"}, acceleration={1: "a"}, band=band).measure(1)
    assert told in str(refused.value)
