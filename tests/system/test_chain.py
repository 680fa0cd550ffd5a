from __future__ import annotations

import numpy as np
import pytest
import torch

from pinn_cli.system import Structure, build_chain
from pinn_cli.system.building import chain_of
from pinn_cli.system.connection import Duffing, Linear, PowerDamping, VanDerPol

VARIANTS = {
    "linear": (Linear(), {}),
    "duffing": (Duffing(), {"kappa": 100.0}),
    "van_der_pol": (VanDerPol(), {"mu": 0.75}),
    "power_damping": (PowerDamping(1.5), {"mu": 0.75}),
}


@pytest.fixture(params=VARIANTS)
def structure(request) -> Structure:
    nonlinearity, coefficients = VARIANTS[request.param]
    spread = {name: [value * (1.0 + 0.1 * i) for i in range(4)] for name, value in coefficients.items()}
    return build_chain(4, nonlinearity, m=[10.0, 9.0, 8.0, 7.0], c=[1.0, 2.0, 3.0, 4.0], k=15.0, **spread)


def random_states(count: int, *shape: int, dtype=torch.float64) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return [torch.randn(shape, generator=generator, dtype=dtype) for _ in range(count)]


def test_equation_of_motion_of_every_dof_written_out(structure):
    # An independent loop over the connections, as the free-body diagram of each mass has it.
    u, v, a = random_states(3, 4)
    p = {name: value.tolist() for name, value in structure.parameters.items()}
    force = [p["m"][i] * a[i].item() for i in range(4)]
    for i in range(4):
        e = u[i].item() - (u[i - 1].item() if i else 0.0)
        de = v[i].item() - (v[i - 1].item() if i else 0.0)
        r = p["c"][i] * de + p["k"][i] * e
        r += {
            "linear": lambda i, e, de: 0.0,
            "duffing": lambda i, e, de: p["kappa"][i] * e**3,
            "van_der_pol": lambda i, e, de: p["mu"][i] * (e**2 - 1.0) * de,
            "power_damping": lambda i, e, de: p["mu"][i] * np.sign(de) * abs(de) ** 1.5,
        }[structure.nonlinearity.name](i, e, de)
        force[i] += r
        if i:
            force[i - 1] -= r
    torch.testing.assert_close(structure.external_force(u, v, a), torch.tensor(force, dtype=torch.float64))


def test_acceleration_undoes_external_force(structure):
    u, v, a = random_states(3, 5, 4)
    torch.testing.assert_close(structure.acceleration(u, v, structure.external_force(u, v, a)), a)


def test_numpy_and_torch_give_the_same(structure):
    u, v, f = random_states(3, 5, 4)
    of_tensors = structure.acceleration(u, v, f).numpy()
    np.testing.assert_allclose(structure.acceleration(u.numpy(), v.numpy(), f.numpy()), of_tensors, rtol=1e-14)


def test_derivatives_in_state_and_parameters_are_right(structure):
    names = tuple(structure.parameters)
    states = [x.requires_grad_() for x in random_states(3, 3, 4)]
    values = [structure.parameters[name].clone().requires_grad_() for name in names]

    def force(u, v, a, *values):
        return structure.external_force(u, v, a, dict(zip(names, values, strict=True)))

    assert torch.autograd.gradcheck(force, (*states, *values))
    assert torch.autograd.gradgradcheck(force, (*states, *values))


def test_forward_mode_and_vectorised_transforms_pass_through(structure):
    u, v, f = random_states(3, 4)
    jacobian = torch.func.jacfwd(lambda x: structure.acceleration(x, v, f))(u)
    torch.testing.assert_close(jacobian, torch.func.jacrev(lambda x: structure.acceleration(x, v, f))(u))
    batch = random_states(1, 6, 4)[0]
    mapped = torch.func.vmap(lambda x: structure.restoring_force(x, v))(batch)
    torch.testing.assert_close(mapped, structure.restoring_force(batch, v.expand(6, 4)))


def test_parameters_may_vary_in_time(structure):
    u, v, a = random_states(3, 5, 4)
    varying = {name: value * torch.linspace(1.0, 2.0, 5)[:, None] for name, value in structure.parameters.items()}
    force = structure.external_force(u, v, a, varying)
    last = structure.external_force(
        u[-1], v[-1], a[-1], {name: 2.0 * value for name, value in structure.parameters.items()}
    )
    torch.testing.assert_close(force[-1], last)


def test_dtype_and_device_are_those_of_the_state(structure):
    u, v, f = random_states(3, 5, 4, dtype=torch.float32)
    assert structure.acceleration(u, v, f).dtype == torch.float32
    assert structure.acceleration(u.numpy(), v.numpy(), f.numpy()).dtype == np.float32
    # The meta device stands in for a GPU: a parameter left on the CPU would raise.
    meta = structure.acceleration(*(x.to("meta") for x in (u, v, f)))
    assert meta.device.type == "meta"
    assert meta.shape == (5, 4)


def test_own_parameters_keep_their_graph(structure):
    k = structure.parameters["k"].clone().requires_grad_()
    u, v, a = random_states(3, 5, 4)
    structure.with_parameters(k=k).external_force(u, v, a).pow(2).sum().backward()
    assert torch.all(k.grad != 0.0)


def test_a_single_dof_is_an_oscillator():
    structure = build_chain(1, Duffing(), m=2.0, c=3.0, k=5.0, kappa=7.0)
    u, v, a = (torch.tensor([x], dtype=torch.float64) for x in (0.1, 0.2, 0.3))
    assert structure.external_force(u, v, a).item() == pytest.approx(2 * 0.3 + 3 * 0.2 + 5 * 0.1 + 7 * 0.1**3)


def test_linearised_drops_the_nonlinearity_and_keeps_the_rest(structure):
    linear = structure.linearised()
    assert linear.nonlinearity.name == "linear"
    assert set(linear.parameters) == {"m", "c", "k"}
    u = torch.full((4,), 1e-9, dtype=torch.float64)
    at_rest = torch.zeros(4, dtype=torch.float64)
    torch.testing.assert_close(structure.restoring_force(u, at_rest), linear.restoring_force(u, at_rest))


def test_a_chain_checks_itself():
    one = torch.ones(3, dtype=torch.float64)
    with pytest.raises(ValueError, match="kappa"):
        chain_of({"m": one, "c": one, "k": one}, Duffing())
    with pytest.raises(ValueError, match="numbers, not"):
        chain_of({"m": one, "c": one, "k": torch.ones(2, dtype=torch.float64)}, Linear())
    with pytest.raises(ValueError, match="mu"):
        chain_of({"m": one, "c": one, "k": one}, Linear()).with_parameters(mu=one)
