"""What a mode shows in a record without a window."""

from __future__ import annotations

import numpy as np
from vibrating_records import of_building

from pinn_cli.record.identification.lines import Lines, Pole
from pinn_cli.record.identification.power_fit import PowerFit


def test_power_of_a_mode_is_the_sum_over_lags():
    record = of_building(0)
    lines = Lines.of(record.outputs[:600], record.inputs[:600], 0.02)
    pole = Pole(3.43, 0.01)
    fit = PowerFit(lines, pole, (), np.ones(3))
    lag = np.arange(600)[:, None]
    omega = 2.0 * np.pi * fit.band.frequency * 0.02
    correlation = np.exp(pole.at * 0.02 * lag) * (1.0 - lag / 600)
    both = 2.0 * correlation * np.cos(omega * lag) * np.where(lag == 0, 0.5, 1.0)
    expected = both.sum(axis=0) * abs(pole.at.real * 0.02)
    np.testing.assert_allclose(fit._shown(pole), np.stack((expected.real, -expected.imag), axis=1), atol=1e-9)


def test_slopes_of_a_pole():
    pole = Pole(2.0, 0.05)
    by = 1e-6 * np.eye(2)
    np.testing.assert_allclose([(pole.moved(x).at - pole.moved(-x).at) / 2e-6 for x in by], pole.slopes, rtol=1e-6)
