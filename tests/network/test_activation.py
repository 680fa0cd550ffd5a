from itertools import islice

import pytest
import torch

from pinn_cli.network.activation import ACTIVATIONS, propagate

FUNCTIONS = {"silu": torch.nn.functional.silu, "tanh": torch.tanh, "sine": torch.sin}


def test_every_activation_is_tested():
    assert set(FUNCTIONS) == set(ACTIVATIONS)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivatives_are_those_of_autograd(name, dtype):
    z = torch.linspace(-6.0, 6.0, 41, dtype=dtype, requires_grad=True)
    expected = [FUNCTIONS[name](z)]
    for _ in range(3):
        expected.append(torch.autograd.grad(expected[-1].sum(), z, create_graph=True)[0])
    for order in range(4):
        given = list(islice(ACTIVATIONS[name](z), order + 1))
        assert len(given) == order + 1
        for mine, theirs in zip(given, expected[: order + 1], strict=True):
            assert mine.dtype == dtype
            torch.testing.assert_close(mine, theirs)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_jet_follows_the_chain_rule(name):
    t = torch.linspace(0.0, 1.0, 11, dtype=torch.float64, requires_grad=True)
    inner = torch.sin(3.0 * t) + t**2
    jet = (inner, 3.0 * torch.cos(3.0 * t) + 2.0 * t, -9.0 * torch.sin(3.0 * t) + 2.0)
    expected = [FUNCTIONS[name](inner)]
    for _ in range(2):
        expected.append(torch.autograd.grad(expected[-1].sum(), t, create_graph=True)[0])
    for order in range(3):
        given = propagate(ACTIVATIONS[name], jet[: order + 1])
        assert len(given) == order + 1
        for mine, theirs in zip(given, expected[: order + 1], strict=True):
            torch.testing.assert_close(mine, theirs)


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
