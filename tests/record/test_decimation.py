from __future__ import annotations

import numpy as np
import pytest

from pinn_cli.record.spectrum import decimate

RATE = 1000.0


def waves(frequency: float, samples: int = 4001) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(samples) / RATE
    return time, np.stack([np.sin(2 * np.pi * frequency * time + phase) for phase in (0.0, 1.0)], axis=1)


@pytest.mark.parametrize("factor", [2, 3, 4, 7])
def test_slow_content_stays_where_it_is(factor):
    # 0.8 of the new Nyquist frequency; a filter with a phase would shift it.
    time, values = waves(0.4 * RATE / factor)
    kept = decimate(values, factor)
    assert len(kept) == len(time[::factor])
    middle = slice(10, -10)
    np.testing.assert_allclose(kept[middle], values[::factor][middle], atol=0.04)
    time, values = waves(0.2 * RATE / factor)
    np.testing.assert_allclose(decimate(values, factor)[middle], values[::factor][middle], atol=0.005)


@pytest.mark.parametrize("factor", [2, 4])
def test_fast_content_goes_instead_of_folding_down(factor):
    _, values = waves(0.62 * RATE / factor if factor > 2 else 0.31 * RATE)
    assert np.max(np.abs(decimate(values, factor)[10:-10])) < 0.01


def test_the_ends_are_as_good_as_a_longer_record():
    time, values = waves(7.3)
    values = values + 0.5 * np.sin(2 * np.pi * 17.0 * time + 0.3)[:, None]
    whole = decimate(values, 4)
    cut = decimate(values[400:3601], 4)
    np.testing.assert_allclose(cut, whole[100:901], atol=0.02)
    np.testing.assert_allclose(cut[10:-10], whole[110:891], atol=1e-12)


def test_a_constant_and_a_ramp_pass_to_the_very_ends():
    ramp = np.stack([np.full(200, 3.0), np.linspace(-1.0, 1.0, 200)], axis=1)
    np.testing.assert_allclose(decimate(ramp, 5), ramp[::5], atol=5e-3)
