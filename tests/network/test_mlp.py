"""The multilayer perceptron: size, weights and where they start, activations, and features of the time before it."""

import math

import numpy as np
import pytest
import torch
from small_problems import accelerations, measured, small_chain, sped_up

from pinn_cli.network.activation import ACTIVATIONS, propagate
from pinn_cli.network.mlp import FourierFeatures, Mlp, embedding
from pinn_cli.record.channels import motion_amplitudes, record_band
from pinn_cli.record.record import Record


@pytest.fixture(scope="module")
def record() -> Record:
    return accelerations(measured(small_chain(), snr_db=40.0).record)


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


def test_minutes_of_noise_that_are_integrated_twice_are_no_motion():
    time = np.arange(0.0, 400.0, 0.04)
    sine = 1e-3 * np.sin(2.0 * np.pi * time)
    noisy = -((2.0 * np.pi) ** 2) * sine + np.random.default_rng(0).normal(0.0, 4e-3, len(time))
    unknown = np.full((len(time), 1), np.nan)
    record = Record(time, unknown, unknown, noisy[:, None], unknown, unforced=np.zeros(1, bool))
    assert motion_amplitudes(record)["displacement"] == pytest.approx(sine.std(), rel=0.1)


def test_a_silent_record_has_an_amplitude(record):
    silent = Record(**{**vars(record), "acceleration": 0.0 * record.acceleration})
    assert set(motion_amplitudes(silent).values()) == {1.0}


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


def test_points_tell_features_beyond_the_band_apart(record):
    band = embedding("fourier", record, torch.float64).count
    assert embedding("fourier", record, torch.float64, 10 * band).count == 2 * np.ceil(1.5 * band / 2)
    few = int(1.2 * band)
    assert band < embedding("fourier", record, torch.float64, few).count < few
    assert embedding("fourier", record, torch.float64, band // 2).count == band


def test_a_network_made_nearly_linear_is_linear_in_its_weights(record):
    """Half a step of its weights makes half the change, to a few thousandths."""
    network = Mlp(1, 20, "sine", "exact", "fourier").build(record)
    gain = network.make_nearly_linear()
    time = torch.tensor(record.time)
    slopes = network.mean_slopes(time)[0][0]
    gram = slopes @ slopes.T
    torch.testing.assert_close(
        gram, float(gram[0, 0]) * torch.eye(len(gram)).to(gram), rtol=1e-3, atol=1e-3 * float(gram[0, 0])
    )
    motions = []
    with torch.no_grad():
        direction = torch.randn(network.weights[0].shape, generator=torch.Generator().manual_seed(0)).double() / gain
        for share in (0.0, 0.5, 1.0):
            network.weights[0].add_((0.5 if share else 0.0) * 0.1 * direction)
            motions.append(network(time).displacement)
    whole, half = motions[2] - motions[0], motions[1] - motions[0]
    assert float((whole - 2.0 * half).abs().max()) < 3e-3 * float(whole.abs().max())
    assert float((motions[0] / network.amplitude).mean(0).abs().max()) < 0.1


@pytest.mark.parametrize(("depth", "activation"), [(1, "sine"), (2, "silu"), (3, "tanh")])
def test_mean_slopes_are_what_a_nearly_linear_network_does_with_its_weights(record, depth, activation):
    network = Mlp(depth, 14, activation, "exact", "fourier").build(record)
    network.make_nearly_linear()
    time = torch.tensor(record.time)[::5]
    slopes, means = network.mean_slopes(time)
    for layer in range(depth + 1):
        weight = network.weights[layer]
        generator = torch.Generator().manual_seed(layer)
        change = 1e-6 * torch.randn(weight.shape, generator=generator, dtype=torch.float64)
        with torch.no_grad():
            before = network.jet(time, 0)[0] / network.amplitude
            weight.add_(change)
            after = network.jet(time, 0)[0] / network.amplitude
            weight.sub_(change)
        expected = slopes[layer] @ change @ means[layer]
        difference = (after - before).mean(0)
        torch.testing.assert_close(difference, expected, rtol=0.02, atol=0.02 * float(expected.abs().max()))


def test_a_network_of_the_time_alone_is_left_as_it_is(record):
    network = Mlp(2, 8, "sine", "exact").build(record)
    before = [weight.clone() for weight in network.parameters()]
    assert network.make_nearly_linear() == 1.0
    assert all(torch.equal(a, b) for a, b in zip(before, network.parameters(), strict=True))


FUNCTIONS = {"silu": torch.nn.functional.silu, "tanh": torch.tanh, "sine": torch.sin}


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_an_activation_is_the_function_of_its_name(name):
    z = torch.linspace(-6.0, 6.0, 41)
    torch.testing.assert_close(next(iter(ACTIVATIONS[name](z))), FUNCTIONS[name](z))


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_gradients_of_a_jet_are_exact_to_second_order(name, order):
    generator = torch.Generator().manual_seed(0)
    jet = tuple(
        torch.randn(3, 2, dtype=torch.float64, generator=generator, requires_grad=True) for _ in range(order + 1)
    )

    def outgoing(*jet: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return propagate(ACTIVATIONS[name], jet)

    assert torch.autograd.gradcheck(outgoing, jet, check_forward_ad=True, check_undefined_grad=False)
    assert torch.autograd.gradgradcheck(outgoing, jet)


@pytest.mark.parametrize("transform", [torch.func.jacrev, torch.func.jacfwd])
def test_functional_transforms_go_through_a_jet(transform):
    jet = torch.randn(2, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))

    def acceleration(z: torch.Tensor) -> torch.Tensor:
        return propagate(ACTIVATIONS["silu"], (z, jet[0], jet[1]))[2]

    z = torch.linspace(-1.0, 1.0, 4, dtype=torch.float64)
    expected = torch.autograd.functional.jacobian(acceleration, z)
    torch.testing.assert_close(transform(acceleration)(z), expected)
    torch.testing.assert_close(torch.func.vmap(acceleration)(torch.stack((z, 2.0 * z)))[0], acceleration(z))
