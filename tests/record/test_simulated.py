from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from pinn_cli.cli.records import OF_THE_RUN
from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.noise import Noise
from pinn_cli.record.record import Measurements
from pinn_cli.record.simulated import Simulated
from pinn_cli.record.simulation import Simulation
from pinn_cli.settings.instantiation import build
from pinn_cli.system import build_chain
from pinn_cli.system.connection import Duffing

CONF = Path(__file__).parents[2] / "conf" / "data" / "simulated.yaml"
CHAIN = build_chain(3, Duffing(), m=10.0, c=1.0, k=15.0, kappa=100.0)
EXCITATION = BandedNoise(3, 20.0, 512, band=[0.05, 1.0], rms=1.0, dofs=[1, 3])


def measured(snr_db: float | None = 20.0, hold: str = "exact") -> Measurements:
    parts = {"excitation": EXCITATION, "simulation": Simulation(20.0, 512, hold), "noise": Noise(snr_db)}
    node = OmegaConf.load(CONF)
    for name in OF_THE_RUN:
        del node[name]
    source = build(node, "data", **parts)
    assert source == Simulated(**parts)
    return source.measure(CHAIN)


@pytest.mark.parametrize(("hold", "intersample"), [("exact", "band_limited"), ("zero_order", "zero_order_hold")])
def test_every_sensor_exists_and_the_hold_is_stated(hold, intersample):
    record = measured(hold=hold).record
    assert record.intersample == intersample
    for quantity in ("displacement", "velocity", "acceleration"):
        assert record.sensors(quantity).all()
    assert record.sensors("force").tolist() == [True, False, True]
    assert record.unforced.tolist() == [False, True, False]
    assert not record.force[:, 1].any()


def test_the_truth_is_clean_and_has_the_true_parameters():
    measurements = measured()
    truth = measurements.truth.response
    u, v, a = (truth.displacement, truth.velocity, truth.acceleration)
    np.testing.assert_allclose(CHAIN.external_force(u, v, a), truth.force, atol=1e-12)
    assert measurements.truth.parameters["kappa"].tolist() == [100.0] * 3
    noise = measurements.record.acceleration - truth.acceleration
    ratio = 10.0 * np.log10(np.mean(truth.acceleration**2, axis=0) / np.mean(noise**2, axis=0))
    np.testing.assert_allclose(ratio, 20.0, atol=1.0)


def test_without_noise_the_record_is_the_truth():
    measurements = measured(snr_db=None)
    np.testing.assert_array_equal(measurements.record.velocity, measurements.truth.response.velocity)
