from typing import ClassVar

import pytest
import torch

from pinn_cli.system import matrices
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Linear, Nonlinearity, PowerDamping, VanDerPol

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
