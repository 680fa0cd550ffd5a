"""Structures of any topology against dense matrices and automatic differentiation."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from structures import braced, shuffled

from pinn_cli.system.building import chain_of
from pinn_cli.system.connection import Linear
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.parameters import Parameter, ParameterVector

STRUCTURES = {"braced": braced, "shuffled": shuffled}


@pytest.fixture(params=STRUCTURES)
def structure(request):
    return STRUCTURES[request.param]()


def random_states(structure, count: int = 3, shape: tuple[int, ...] = (5,)) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return [torch.randn((*shape, structure.ndof), generator=generator, dtype=torch.float64) for _ in range(count)]


def force_written_out(structure, u, v, a):
    """Connection by connection, by the weights of its coordinates."""
    p, matrix = structure.parameters, structure.incidence.matrix.toarray()
    force = p["m"] * a
    special = {kind: list(members) for kind, members in structure.members.items() if kind in ("kappa", "mu")}
    for c, row in enumerate(torch.as_tensor(matrix)):
        e, de = (u * row).sum(-1), (v * row).sum(-1)
        r = p["c"][c] * de + p["k"][c] * e
        if c in special.get("kappa", ()):
            r = r + p["kappa"][special["kappa"].index(c)] * e**3
        if c in special.get("mu", ()):
            r = r + p["mu"][special["mu"].index(c)] * (e**2 - 1.0) * de
        force = force + r[..., None] * row
    return force


def test_the_equation_of_motion_written_out(structure):
    u, v, a = random_states(structure)
    expected = force_written_out(structure, u, v, a)
    torch.testing.assert_close(structure.external_force(u, v, a), expected)
    arrays = (x.numpy() for x in (u, v, a))
    np.testing.assert_allclose(structure.external_force(*arrays), expected)
    torch.testing.assert_close(structure.acceleration(u, v, expected), a)


def test_the_linearisation_is_the_slope_of_the_force(structure):
    u, v, a = random_states(structure, shape=())
    every = list(structure.every_parameter())
    vector = ParameterVector(structure.parameters, every)

    def force(u, v, distances):
        return structure.external_force(u, v, a, vector.values(distances))

    at = torch.zeros(len(every), dtype=torch.float64)
    by_u, by_v, by_parameter = torch.autograd.functional.jacobian(force, (u, v, at))
    found = structure.linearise(u, v, structure.parameters)
    pull = torch.as_tensor(structure.incidence.matrix.toarray()).T
    torch.testing.assert_close(pull @ torch.diag(found.stiffness) @ pull.T, by_u)
    torch.testing.assert_close(pull @ torch.diag(found.damping) @ pull.T, by_v)
    torch.testing.assert_close(structure.by_parameters(found, every, a), by_parameter)


def test_many_connections_are_looked_up_and_few_multiplied():
    few, many = Incidence.chain(60), Incidence.chain(70)
    x = np.random.default_rng(0).normal(size=(3, 70))
    np.testing.assert_array_equal(few.elongation(x[:, :60]), many.elongation(x)[:, :60])
    np.testing.assert_array_equal(few.pull(x[:, :60])[:, :59], many.pull(x)[:, :59])
    for incidence, values in ((few, x[:, :60].copy()), (many, x)):
        tensor = torch.as_tensor(values)
        np.testing.assert_array_equal(incidence.elongation(tensor), incidence.elongation(values))
        np.testing.assert_array_equal(incidence.pull(tensor), incidence.pull(values))
        np.testing.assert_allclose(incidence.elongation(values), values @ incidence.matrix.toarray().T)
        np.testing.assert_allclose(incidence.pull(values), values @ incidence.matrix.toarray())


def test_what_is_coupled_stands_near_each_other():
    ordered, mixed = (
        Dynamics(chain_of({kind: torch.ones(6, dtype=torch.float64) for kind in ("m", "c", "k")}, Linear())).coupling,
        Dynamics(shuffled(6)).coupling,
    )
    assert ordered.order.tolist() == list(range(6))
    assert mixed.order.tolist() != list(range(6))
    assert (mixed.offsets, mixed.reach) == (ordered.offsets, ordered.reach) == ((-1, 0, 1), 2)
    assert Dynamics(braced()).coupling.reach == 2  # every mass is coupled with every other


def test_whose_equations_contain_a_parameter(structure):
    u, v, a = random_states(structure, shape=())
    for parameter in structure.every_parameter():
        values = structure.parameters[parameter.kind].clone()
        values[parameter.index] *= 1.5
        other = structure.with_parameters(**{parameter.kind: values})
        moved = other.external_force(u, v, a) - structure.external_force(u, v, a)
        assert set(np.flatnonzero(moved.numpy())) == set(structure.ends(parameter))


def test_without_its_nonlinearities(structure):
    u, v, a = random_states(structure)
    linear = structure.linearised()
    assert set(linear.parameters) == {"m", "c", "k"}
    torch.testing.assert_close(linear.external_force(2.0 * u, v, a) - linear.external_force(u, v, a),
                               linear.restoring_force(u, torch.zeros_like(v)))  # fmt: skip


def test_connections_need_ends():
    for wrong in ([{}], [{3: 1.0}], [{-1: 1.0}]):
        with pytest.raises(ValueError, match="a connection has weights"):
            Incidence.between(wrong, 3)


def test_a_parameter_is_the_same_whatever_is_believed_of_it():
    believed, bare = Parameter("kappa", 3, 100.0, 7.5, unit="N/m^3"), Parameter("kappa", 3)
    assert believed == bare
    assert {believed: 1}[bare] == 1
    assert believed != Parameter("kappa", 2)
    assert (bare.name, bare.owner, bare.symbol) == ("kappa_4", "connection 4", r"$\kappa_{4}$")
    assert (Parameter("m", 0).owner, Parameter("k", 0, label="brace").name) == ("DOF 1", "k_brace")


@pytest.mark.parametrize("as_is", [torch.as_tensor, np.asarray], ids=["tensors", "arrays"])
def test_a_vector_of_parameters_by_name(as_is):
    structure = braced()
    moving = [Parameter("mu", 0), Parameter("k", 4), Parameter("m", 1)]
    nominal = {kind: as_is(values.numpy()) for kind, values in structure.parameters.items()}
    vector = ParameterVector(nominal, moving)
    assert (vector.kinds, vector.places) == (("m", "k", "mu"), 3 + 6 + 1)
    values = vector.values(as_is(np.array([0.1, 2.0, -1.0])))
    expected = {kind: given.numpy().copy() for kind, given in structure.parameters.items()}
    expected["mu"][0] += 0.1
    expected["k"][4] += 2.0
    expected["m"][1] -= 1.0
    for kind, given in expected.items():
        np.testing.assert_array_equal(values[kind], given)
