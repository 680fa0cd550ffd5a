"""Equations of motion, memory and inputs against the equations written out, and against the paper's matrices."""

from dataclasses import replace
from typing import ClassVar

import pytest
import torch
from structures import braced, hysteretic, modal

from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Linear, Nonlinearity, PowerDamping, VanDerPol
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.functions import Inputs, Jet
from tests import paper_matrices as matrices

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


CHAINS = {
    "linear": build_chain(4, Linear(), m=[1.0, 2.0, 3.0, 4.0], c=[1.0, 2.0, 3.0, 5.0], k=[15.0, 14.0, 13.0, 11.0]),
    "duffing": build_chain(
        4, Duffing(), m=[1.0, 2.0, 3.0, 4.0], c=2.0, k=[15.0, 14.0, 13.0, 11.0], kappa=[9.0, 8.0, 7.0, 5.0]
    ),
    "van_der_pol": build_chain(4, VanDerPol(), m=10.0, c=[1.0, 2.0, 3.0, 5.0], k=15.0, mu=[0.5, 0.6, 0.7, 0.9]),
    "power_damping": build_chain(4, PowerDamping(2.5), m=10.0, c=1.0, k=15.0, mu=[0.5, 0.6, 0.7, 0.9]),
    "one_dof": build_chain(1, Duffing(), m=10.0, c=1.0, k=15.0, kappa=100.0),
}


@pytest.fixture(params=CHAINS)
def structure(request):
    return CHAINS[request.param]


def states(structure):
    generator = torch.Generator().manual_seed(0)
    return [torch.randn(6, structure.ndof, generator=generator, dtype=torch.float64) for _ in range(3)]


def test_the_papers_appendix_entry_by_entry():
    c1, c2, c3, c4 = 1.0, 2.0, 3.0, 5.0
    expected = [[c1 + c2, -c2, 0, 0], [-c2, c2 + c3, -c3, 0], [0, -c3, c3 + c4, -c4], [0, 0, -c4, c4]]
    assert matrices.damping(CHAINS["linear"]).tolist() == expected
    k1, k2, k3, k4 = 15.0, 14.0, 13.0, 11.0
    expected = [[k1 + k2, -k2, 0, 0], [-k2, k2 + k3, -k3, 0], [0, -k3, k3 + k4, -k4], [0, 0, -k4, k4]]
    assert matrices.stiffness(CHAINS["duffing"]).tolist() == expected
    expected = [[9.0, -8.0, 0, 0], [0, 8.0, -7.0, 0], [0, 0, 7.0, -5.0], [0, 0, 0, 5.0]]
    assert matrices.nonlinear_stiffness(CHAINS["duffing"]).tolist() == expected
    assert not matrices.nonlinear_damping(CHAINS["duffing"]).any()
    expected = [[0.5, -0.6, 0, 0], [0, 0.6, -0.7, 0], [0, 0, 0.7, -0.9], [0, 0, 0, 0.9]]
    assert matrices.nonlinear_damping(CHAINS["van_der_pol"]).tolist() == expected
    assert not matrices.nonlinear_stiffness(CHAINS["van_der_pol"]).any()
    assert matrices.mass(CHAINS["linear"]).tolist() == torch.diag(torch.tensor([1.0, 2.0, 3.0, 4.0])).tolist()


def test_nonlinear_functions_are_the_papers():
    u, v, _ = states(CHAINS["duffing"])
    e, de = torch.diff(u, dim=-1, prepend=torch.zeros(6, 1)), torch.diff(v, dim=-1, prepend=torch.zeros(6, 1))
    g = matrices.nonlinear_functions(CHAINS["duffing"], u, v)
    torch.testing.assert_close(g, torch.cat([e**3, torch.zeros_like(e)], -1))
    g = matrices.nonlinear_functions(CHAINS["van_der_pol"], u, v)
    torch.testing.assert_close(g, torch.cat([torch.zeros_like(e), (e**2 - 1.0) * de], -1))


def test_second_order_matrices_agree_with_the_elongation_form(structure):
    u, v, a = states(structure)
    g_k, g_c = matrices.nonlinear_functions(structure, u, v).chunk(2, -1)
    force = a @ matrices.mass(structure).T + v @ matrices.damping(structure).T + u @ matrices.stiffness(structure).T
    force = force + g_k @ matrices.nonlinear_stiffness(structure).T + g_c @ matrices.nonlinear_damping(structure).T
    torch.testing.assert_close(force, structure.external_force(u, v, a))


def test_state_equation_agrees_with_the_elongation_form(structure):
    u, v, f = states(structure)
    g = matrices.nonlinear_functions(structure, u, v)
    z = torch.cat([u, v], -1)
    slope = (
        z @ matrices.state(structure).T + g @ matrices.nonlinear_state(structure).T + f @ matrices.input(structure).T
    )
    torch.testing.assert_close(slope, torch.cat([v, structure.acceleration(u, v, f)], -1))


def test_output_equation_picks_the_sensors():
    structure = CHAINS["duffing"]
    sensors = {"displacement": [4, 1], "velocity": [2], "acceleration": [1, 3]}
    u, v, f = states(structure)
    g = matrices.nonlinear_functions(structure, u, v)
    of_state, of_nonlinear, of_force = matrices.outputs(structure, **sensors)
    y = torch.cat([u, v], -1) @ of_state.T + g @ of_nonlinear.T + f @ of_force.T
    a = structure.acceleration(u, v, f)
    torch.testing.assert_close(y, torch.stack([u[:, 3], u[:, 0], v[:, 1], a[:, 0], a[:, 2]], -1))


def test_selection_counts_from_one():
    assert matrices.selection([3, 1], 3).tolist() == [[0, 0, 1], [1, 0, 0]]
    assert matrices.selection([], 3).shape == (0, 3)
    with pytest.raises(ValueError, match="DOF 0"):
        matrices.selection([0], 3)


def test_a_nonlinearity_that_the_paper_has_no_matrix_for_says_so():
    class Free(Nonlinearity):
        name: ClassVar[str] = "free"
        parameters: ClassVar[tuple[str, ...]] = ("alpha",)

        def force(self, e, de, parameters):
            return parameters["alpha"] * e * de

    structure = build_chain(2, Free(), m=1.0, c=1.0, k=1.0, alpha=1.0)
    with pytest.raises(ValueError, match="no matrix form"):
        matrices.nonlinear_stiffness(structure)
