from __future__ import annotations

import numpy as np
import pytest
import torch
from small_problems import accelerations, measured, small_chain, sped_up

from pinn_cli.errors import InputError
from pinn_cli.network.embedding import FourierFeatures, embedding
from pinn_cli.network.mlp import Mlp
from pinn_cli.record.record import Record
from pinn_cli.record.spectrum import record_band


@pytest.fixture(scope="module")
def record() -> Record:
    return accelerations(measured(small_chain(), snr_db=40.0).record)


def test_derivatives_carried_forward_are_those_of_autograd(record):
    network = Mlp(2, 7, "sine", "exact", "fourier").build(record)
    time = torch.tensor(record.time[::16], requires_grad=True)

    def slope(value):
        return torch.stack([torch.autograd.grad(x.sum(), time, create_graph=True)[0] for x in value.T], -1)

    value, rate, curvature = network.jet(time, 2)
    torch.testing.assert_close(rate, slope(value))
    torch.testing.assert_close(curvature, slope(slope(value)), rtol=1e-6, atol=1e-8)
    torch.testing.assert_close(network.jet(time, 1), (value, rate))


def test_features_reach_the_records_band_and_fall_off(record):
    features = embedding("fourier", record, torch.float64)
    assert isinstance(features, FourierFeatures)
    highest = float(features.omega[-1]) / (2.0 * np.pi) / record.duration
    assert highest == pytest.approx(record_band(record), rel=0.1)
    assert (features.amplitude.diff() < 0).all()
    assert float(features.amplitude.square().sum()) == pytest.approx(1.0)


def test_features_follow_the_records_own_speed(record):
    fast = embedding("fourier", sped_up(record, 50.0), torch.float64)
    torch.testing.assert_close(fast.amplitude, embedding("fourier", record, torch.float64).amplitude)


def test_an_embedded_network_starts_around_rest(record):
    network = Mlp(1, 20, "sine", "exact", "fourier").build(record)
    network.reset(3)
    motion = network(torch.tensor(record.time)).displacement / network.amplitude
    assert float(motion.mean(0).abs().max()) < 0.1
    assert float(motion.abs().max()) < 1.0
    again = Mlp(1, 20, "sine", "exact", "fourier").build(record)
    again.reset(3)
    torch.testing.assert_close(dict(again.named_parameters()), dict(network.named_parameters()), rtol=0, atol=0)


def test_an_unknown_embedding_is_an_input_error():
    with pytest.raises(InputError, match=r"network.embedding=wavelet: must be"):
        Mlp(embedding="wavelet")  # type: ignore[arg-type]
