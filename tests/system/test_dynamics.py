"""Equations of motion, memory and inputs against the equations written out, and against the paper's matrices."""

from dataclasses import replace

import pytest
import torch
from structures import braced, hysteretic, modal

from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Linear, VanDerPol
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.functions import Inputs, Jet

GROUND_AND_FORCES = Inputs(True, True, (1,), correlation_time=0.3, damping_ratio=0.6, rate=4.0, edge=11.0)
ON_MODES = Inputs(True, True, (1,), correlation_time=0.3, rate=4.0, edge=11.0, loads=(0, 3))


def some_jet(dynamics, times: int = 4) -> Jet:
    generator = torch.Generator().manual_seed(3)
    return Jet(*(torch.randn((times, dynamics.size), generator=generator, dtype=torch.float64) for _ in range(3)))


def test_the_functions_in_their_order():
    dynamics = Dynamics(hysteretic(), GROUND_AND_FORCES)
    assert (dynamics.ndof, dynamics.size) == (2, 6)
    assert [dynamics.hidden, dynamics.ground, dynamics.forces] == [slice(2, 4), slice(4, 5), slice(5, 6)]


def test_the_equations_written_out():
    dynamics = Dynamics(hysteretic(), GROUND_AND_FORCES)
    y, dy, ddy = (x[0].tolist() for x in some_jet(dynamics, 1))
    (u1, u2, z1, z2, g, w), (v1, v2, dz1, dz2, dg, dw), (a1, a2, _, _, ddg, ddw) = y, dy, ddy
    r1 = 1.0 * v1 + 15.0 * u1 + 30.0 * u1**3
    r2 = 1.2 * (v2 - v1) + 6.0 * (u2 - u1) + z1
    r3 = 0.7 * v2 + 4.0 * u2 + z2
    h1 = 9.0 * (v2 - v1) - 2.0 * abs(v2 - v1) * z1 + 0.6 * (v2 - v1) * abs(z1)
    h2 = 7.0 * v2 - 1.4 * abs(v2) * abs(z2) ** 0.3 * z2 - 0.5 * v2 * abs(z2) ** 1.3
    expected = [
        10.0 * (a1 + g) + r1 - r2,
        8.0 * (a2 + g) + r2 + r3 - w,
        (dz1 - h1) / 4.0,
        (dz2 - h2) / 4.0,
        ddg / 11.0**2 + 2.0 * dg / 11.0 + g,
        (0.3 / (2.0 * 0.6)) ** 2 * ddw + 0.3 * dw + w,
    ]
    jet = some_jet(dynamics, 1)
    found = dynamics.residual(jet, dynamics.structure.parameters)[0]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64), rtol=1e-12, atol=1e-12)
    force = dynamics.external_force(jet, dynamics.structure.parameters)[0]
    torch.testing.assert_close(force, torch.tensor([expected[0], w], dtype=torch.float64), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("absolute", [True, False])
def test_what_sensors_of_modes_feel(absolute):
    dynamics = Dynamics(modal(), replace(ON_MODES, absolute=absolute))
    jet, shapes = some_jet(dynamics), torch.as_tensor(modal().shapes.matrix)
    ground, loads, force = jet.value[:, 3:4], jet.value[:, 4:6], jet.value[:, 6]
    carried = torch.tensor([1.0, 0.0, 1.0, 1.0], dtype=torch.float64) if absolute else 0.0
    expected = {
        "displacement": jet.value[:, :3] @ shapes.T,
        "velocity": jet.rate[:, :3] @ shapes.T,
        "acceleration": jet.curvature[:, :3] @ shapes.T + ground * carried,
        "ground_acceleration": ground,
        "force": torch.stack((loads[:, 0], force, torch.zeros(4), loads[:, 1]), 1),
    }
    assert dynamics.observed == tuple(expected)
    for quantity, values in expected.items():
        torch.testing.assert_close(dynamics.sensed(quantity, jet), values)
        sensing = sum(jet[order] @ torch.as_tensor(w.toarray()).T for order, w in dynamics.sensing(quantity))
        torch.testing.assert_close(sensing, values)
        assert not dynamics.feels_coordinate(quantity)
    torch.testing.assert_close(dynamics.external_force(jet, dynamics.structure.parameters), expected["force"])


def test_forces_on_dofs_push_the_modes():
    dynamics = Dynamics(modal(), ON_MODES)
    jet, parameters, shapes = some_jet(dynamics), modal().parameters, torch.as_tensor(modal().shapes.matrix)
    pushed = dynamics.external_force(jet, parameters) @ shapes
    u, v, a = (x[:, :3] for x in jet)
    moved = dynamics.inertial_acceleration(jet)
    torch.testing.assert_close(moved, a + jet.value[:, 3:4] * torch.tensor([0.9, -0.3, 0.5], dtype=torch.float64))
    expected = moved + modal().restoring_force(u, v, parameters) - pushed
    torch.testing.assert_close(dynamics.residual(jet, parameters)[:, :3], expected)


def test_of_a_motion_alone_nothing_is_added():
    dynamics, parameters = Dynamics(braced()), braced().parameters
    jet = some_jet(dynamics)
    assert dynamics.is_plain
    assert not dynamics.also_unknown
    assert torch.equal(dynamics.residual(jet, parameters), dynamics.structure.external_force(*jet, parameters))


def test_the_papers_appendix_entry_by_entry():
    """Its last off-diagonals of C and K put right: -c_n and -k_n."""
    four, (c1, c2, c3, c4), (k1, k2, k3, k4) = [1.0, 2.0, 3.0, 4.0], (1.0, 2.0, 3.0, 5.0), (15.0, 14.0, 13.0, 11.0)
    linear = {"m": four, "c": [c1, c2, c3, c4], "k": [k1, k2, k3, k4]}
    mass = torch.diag(torch.tensor(four, dtype=torch.float64))
    damping = [[c1 + c2, -c2, 0, 0], [-c2, c2 + c3, -c3, 0], [0, -c3, c3 + c4, -c4], [0, 0, -c4, c4]]
    stiffness = [[k1 + k2, -k2, 0, 0], [-k2, k2 + k3, -k3, 0], [0, -k3, k3 + k4, -k4], [0, 0, -k4, k4]]
    u, v, a = torch.randn((3, 6, 4), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    force = sum(
        x @ torch.as_tensor(matrix).to(x).T for x, matrix in zip((u, v, a), (stiffness, damping, mass), strict=True)
    )
    torch.testing.assert_close(build_chain(4, Linear(), **linear).external_force(u, v, a), force)
    e, de = (torch.diff(x, dim=-1, prepend=torch.zeros(6, 1)) for x in (u, v))
    bidiagonal = torch.tensor(
        [[9.0, -8.0, 0, 0], [0, 8.0, -7.0, 0], [0, 0, 7.0, -5.0], [0, 0, 0, 5.0]], dtype=torch.float64
    )
    for law, kind, function in ((Duffing(), "kappa", e**3), (VanDerPol(), "mu", (e**2 - 1.0) * de)):
        chain = build_chain(4, law, **linear, **{kind: [9.0, 8.0, 7.0, 5.0]})
        torch.testing.assert_close(chain.external_force(u, v, a), force + function @ bidiagonal.T)
