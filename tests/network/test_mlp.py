"""The multilayer perceptron: its size, its weights and where they start."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from small_problems import accelerations, measured, small_chain

from pinn_cli.network.mlp import Mlp
from pinn_cli.record.channels import motion_amplitudes, record_band
from pinn_cli.record.record import Record


@pytest.fixture(scope="module")
def record() -> Record:
    return accelerations(measured(small_chain(), snr_db=40.0).record)


def test_every_weight_has_the_gradient_that_finite_differences_see(record):
    network = Mlp(2, 3, "silu", "exact").build(record)
    time = torch.tensor(record.time[::64])
    weights = tuple(network.parameters())

    def motion(*values):
        return torch.func.functional_call(
            network, dict(zip(dict(network.named_parameters()), values, strict=True)), time
        )[:3]

    assert torch.autograd.gradcheck(motion, weights, eps=1e-6, atol=1e-5)


def test_the_papers_network_has_the_papers_size(record):
    weights = [tuple(weight.shape) for weight in Mlp().build(record).weights]
    assert weights == [(256, 1), (256, 256), (256, 256), (256, 256), (6, 256)]


def test_the_seed_alone_decides_the_weights(record):
    network = Mlp(2, 8).build(record)
    before = torch.get_rng_state()
    drawn = []
    for seed in (3, 3, 4):
        network.reset(seed)
        drawn.append(torch.cat([weight.detach().flatten() for weight in network.parameters()]))
    assert torch.equal(drawn[0], drawn[1])
    assert not torch.equal(drawn[0], drawn[2])
    assert torch.equal(before, torch.get_rng_state())


def test_sines_begin_as_frequencies_inside_the_records_band(record):
    network = Mlp(2, 256, "sine").build(record)
    frequencies = network.weights[0].abs() / (2.0 * math.pi * record.duration)
    assert 0.4 < frequencies.max().item() / record_band(record) <= 0.5


@pytest.mark.parametrize(
    "sensors", [("displacement",), ("velocity",), ("acceleration",), ("displacement", "acceleration")]
)
def test_amplitudes_are_of_the_motions_size(sensors):
    measurements = measured(small_chain(ndof=1), snr_db=40.0, duration=40.0, samples=1025)
    record = measurements.record.keep(dict.fromkeys(sensors, (1,)))
    for quantity, amplitude in motion_amplitudes(record).items():
        true = float(np.sqrt(np.mean(getattr(measurements.truth.response, quantity) ** 2)))
        assert 0.5 < amplitude / true < 2.0, quantity


def test_a_silent_record_has_an_amplitude(record):
    silent = Record(**{**vars(record), "acceleration": 0.0 * record.acceleration})
    assert set(motion_amplitudes(silent).values()) == {1.0}


@pytest.mark.parametrize(("ndof", "width"), [(3, 20), (12, 36)])
def test_the_width_follows_the_number_of_dofs(ndof, width):
    network = Mlp(1, None, "sine").build(accelerations(measured(small_chain(ndof=ndof), snr_db=40.0).record))
    assert network.weights[0].shape[0] == width
