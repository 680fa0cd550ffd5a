from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from small_problems import accelerations, measured, small_chain, sped_up

from pinn_cli.network.activation import ACTIVATIONS
from pinn_cli.network.mlp import Mlp
from pinn_cli.record.amplitudes import motion_amplitudes
from pinn_cli.record.channels import record_band
from pinn_cli.record.record import Record
from pinn_cli.settings.errors import InputError


@pytest.fixture(scope="module")
def record() -> Record:
    return accelerations(measured(small_chain(), snr_db=40.0).record)


def by_autograd(value, time):
    """Derivative of every column of (N, outputs) by the time of its row."""
    columns = [torch.autograd.grad(column.sum(), time, create_graph=True)[0] for column in value.T]
    return torch.stack(columns, -1)


@pytest.mark.parametrize("continuity", ["exact", "penalised"])
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_derivatives_carried_forward_are_those_of_autograd(record, activation, continuity):
    network = Mlp(3, 16, activation, continuity).build(record)
    time = torch.tensor(record.time[::16], requires_grad=True)
    value, rate, curvature = network.jet(time, 2)
    assert value.shape == (len(time), 3 if continuity == "exact" else 6)
    expected = by_autograd(value, time)
    torch.testing.assert_close(rate, expected)
    torch.testing.assert_close(curvature, by_autograd(expected, time))
    for order in range(2):
        for lower, full in zip(network.jet(time, order), (value, rate), strict=False):
            torch.testing.assert_close(lower, full)


def test_states_with_exact_continuity(record):
    network = Mlp(2, 8, continuity="exact").build(record)
    time = torch.tensor(record.time)
    states = network(time)
    assert states.continuity is None
    for given, expected in zip(states[:3], network.jet(time, 2), strict=True):
        torch.testing.assert_close(given, expected)


def test_states_with_penalised_continuity(record):
    network = Mlp(2, 8).build(record)
    time = torch.tensor(record.time)
    states, (value, rate) = network(time), network.jet(time, 1)
    torch.testing.assert_close(states.velocity, value[:, 3:])
    torch.testing.assert_close(states.acceleration, rate[:, 3:])
    torch.testing.assert_close(states.continuity, rate[:, :3] - value[:, 3:])
    assert states.continuity.abs().max() > 0


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


def test_float32_agrees_with_float64(record):
    design = Mlp(3, 32)
    single, double = design.build(record, torch.float32), design.build(record, torch.float64)
    time = torch.tensor(record.time)
    for low, high in zip(single.jet(time, 2), double.jet(time, 2), strict=True):
        assert low.dtype == torch.float32
        torch.testing.assert_close(low.double(), high, rtol=1e-4, atol=1e-5 * high.abs().max().item())


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


def test_nothing_rests_on_the_time_scale(record):
    fast = sped_up(record, 30.0)
    slow_network, fast_network = (Mlp(3, 16, "sine", "exact").build(given) for given in (record, fast))
    slow_jet = slow_network.jet(torch.tensor(record.time), 2)
    fast_jet = fast_network.jet(torch.tensor(fast.time), 2)
    for order, (slow, quick) in enumerate(zip(slow_jet, fast_jet, strict=True)):
        torch.testing.assert_close(quick, slow * 30.0**order, rtol=1e-6, atol=1e-9 * quick.abs().max().item())


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


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"depth": 0}, "network.depth=0"),
        ({"width": 2.5}, "network.width=2.5"),
        ({"activation": "relu"}, "network.activation=relu: must be one of silu, tanh, sine"),
        ({"continuity": "none"}, "network.continuity=none"),
    ],
)
def test_impossible_settings_are_named(settings, named):
    with pytest.raises(InputError) as error:
        Mlp(**settings)
    assert str(error.value).startswith(named)


def test_refining_leaves_it_as_it_is():
    design = Mlp(2, 16)
    assert design.refined() is design


@pytest.mark.parametrize(("ndof", "width"), [(3, 20), (12, 36)])
def test_the_width_follows_the_number_of_dofs(ndof, width):
    network = Mlp(1, None, "sine").build(accelerations(measured(small_chain(ndof=ndof), snr_db=40.0).record))
    assert network.weights[0].shape[0] == width
