"""Structures of any topology against their equations written out and automatic differentiation; errors of models."""

import csv

import numpy as np
import pytest
import torch
from structures import braced, shuffled

from pinn_cli.system.building import build_chain, chain_of
from pinn_cli.system.connection import Duffing, Linear, PowerDamping, VanDerPol
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.model_error import LinearModelError, NoModelError, PerturbedModelError
from pinn_cli.system.parameters import ParameterVector


def chain(law, **coefficients):
    spread = {name: [value * (1.0 + 0.1 * i) for i in range(4)] for name, value in coefficients.items()}
    return build_chain(4, law, m=[10.0, 9.0, 8.0, 7.0], c=[1.0, 2.0, 3.0, 4.0], k=15.0, **spread)


STRUCTURES = {
    "linear": chain(Linear()),
    "duffing": chain(Duffing(), kappa=100.0),
    "van_der_pol": chain(VanDerPol(), mu=0.75),
    "power_damping": chain(PowerDamping(1.5), mu=0.75),
    "one": build_chain(1, Duffing(), m=2.0, c=3.0, k=5.0, kappa=7.0),
    "braced": braced(),
    "shuffled": shuffled(),
}
# Nonlinear forces written out, of a coefficient, an elongation and its rate.
LAWS = {
    "linear": lambda _, e, de: 0.0 * e,
    "duffing": lambda kappa, e, de: kappa * e**3,
    "van_der_pol": lambda mu, e, de: mu * (e**2 - 1.0) * de,
    "power_damping": lambda mu, e, de: mu * de.sign() * de.abs() ** 1.5,
}


@pytest.fixture(params=STRUCTURES)
def structure(request):
    return STRUCTURES[request.param]


def random_states(structure, count: int = 3, shape: tuple[int, ...] = (5,), dtype=torch.float64) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return [torch.randn((*shape, structure.ndof), generator=generator, dtype=dtype) for _ in range(count)]


def force_written_out(structure, u, v, a):
    """Connection by connection, by the weights of its coordinates, as free-body diagrams have it."""
    p = structure.parameters
    force, used = p["m"] * a, dict.fromkeys(p, 0)
    for c, row in enumerate(torch.as_tensor(structure.incidence.matrix.toarray())):
        law = structure.laws[c]
        e, de = (u * row).sum(-1), (v * row).sum(-1)
        own = [p[kind][used[kind]] for kind in law.parameters]
        used |= {kind: used[kind] + 1 for kind in law.parameters}
        r = p["c"][c] * de + p["k"][c] * e + LAWS[law.name](own[0] if own else None, e, de)
        force = force + r[..., None] * row
    return force


def test_the_equation_of_motion_written_out(structure):
    u, v, a = random_states(structure)
    expected = force_written_out(structure, u, v, a)
    torch.testing.assert_close(structure.external_force(u, v, a), expected)
    np.testing.assert_allclose(structure.external_force(*(x.numpy() for x in (u, v, a))), expected)
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
    for column, p in enumerate(every):
        connections, which = structure.carriers.get(p.kind, ([], np.zeros(0)))
        pulled = pull[:, connections] @ torch.diag(found.by_parameter[p.kind]) if len(connections) else torch.diag(a)
        here = which == p.index if len(connections) else np.arange(len(a)) == p.index
        torch.testing.assert_close(pulled[:, here].sum(1), by_parameter[:, column])


def test_derivatives_in_state_and_parameters_are_right(structure):
    names = tuple(structure.parameters)
    states = [x.requires_grad_() for x in random_states(structure, shape=(2,))]
    values = [structure.parameters[name].clone().requires_grad_() for name in names]

    def force(u, v, a, *values):
        return structure.external_force(u, v, a, dict(zip(names, values, strict=True)))

    assert torch.autograd.gradcheck(force, (*states, *values))
    assert torch.autograd.gradgradcheck(force, (*states, *values))
    own = structure.parameters["k"].clone().requires_grad_()
    structure.with_parameters(k=own).external_force(*(x.detach() for x in states)).pow(2).sum().backward()
    assert torch.all(own.grad != 0.0)


def test_parameters_may_vary_in_time(structure):
    u, v, a = random_states(structure)
    varying = {name: value * torch.linspace(1.0, 2.0, 5)[:, None] for name, value in structure.parameters.items()}
    twice = {name: 2.0 * value for name, value in structure.parameters.items()}
    force = structure.external_force(u, v, a, varying)
    torch.testing.assert_close(force[-1], structure.external_force(u[-1], v[-1], a[-1], twice))


def test_dtype_and_device_are_those_of_the_state(structure):
    u, v, f = random_states(structure, dtype=torch.float32)
    assert structure.acceleration(u, v, f).dtype == torch.float32
    assert structure.acceleration(u.numpy(), v.numpy(), f.numpy()).dtype == np.float32
    # The meta device stands in for a GPU: a parameter left on the CPU would raise.
    meta = structure.acceleration(*(x.to("meta") for x in (u, v, f)))
    assert (meta.device.type, meta.shape) == ("meta", u.shape)


def test_linearised_drops_the_nonlinearity_and_keeps_the_rest(structure):
    linear, (u, v, a) = structure.linearised(), random_states(structure)
    assert set(linear.parameters) == {"m", "c", "k"}
    torch.testing.assert_close(linear.external_force(2.0 * u, v, a) - linear.external_force(u, v, a),
                               linear.restoring_force(u, torch.zeros_like(v)))  # fmt: skip
    torch.testing.assert_close(structure.restoring_force(1e-9 * u, 0.0 * v), linear.restoring_force(1e-9 * u, 0.0 * v))


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


def test_what_is_no_structure_is_refused():
    for wrong in ([{}], [{3: 1.0}], [{-1: 1.0}]):
        with pytest.raises(ValueError, match="a connection has weights"):
            Incidence.between(wrong, 3)
    one = torch.ones(3, dtype=torch.float64)
    with pytest.raises(ValueError, match="kappa"):
        chain_of({"m": one, "c": one, "k": one}, Duffing())
    with pytest.raises(ValueError, match="numbers, not"):
        chain_of({"m": one, "c": one, "k": torch.ones(2, dtype=torch.float64)}, Linear())
    with pytest.raises(ValueError, match="mu"):
        chain_of({"m": one, "c": one, "k": one}, Linear()).with_parameters(mu=one)


NOMINAL = {"m": 10.0, "c": 1.0, "k": 15.0, "kappa": 100.0}


def nominal(ndof: int = 6):
    return build_chain(ndof, Duffing(), **NOMINAL)


def ratios(structure) -> dict[str, np.ndarray]:
    return {name: value.numpy() / NOMINAL[name] for name, value in structure.parameters.items()}


def test_none_changes_nothing_and_linear_prescribes_no_nonlinearity():
    structure = nominal()
    assert NoModelError().structures(structure) == (structure, structure)
    true, prescribed = LinearModelError().structures(structure)
    assert true is structure
    assert prescribed.nonlinearity_name == "linear"
    assert prescribed.parameters["k"].tolist() == [15.0] * 6


def test_perturbed_truth_is_five_to_ten_per_cent_off_either_way_and_the_mass_is_right():
    structure = nominal(200)
    true, prescribed = PerturbedModelError(seed=1).structures(structure)
    assert prescribed is structure
    changed = ratios(true)
    assert np.all(changed.pop("m") == 1.0)
    for ratio in changed.values():
        assert np.all((np.abs(ratio - 1.0) >= 0.05 - 1e-12) & (np.abs(ratio - 1.0) <= 0.10 + 1e-12))
        assert 60 < np.sum(ratio > 1.0) < 140


def test_perturbed_draws_do_not_depend_on_the_other_connections_or_parameters():
    short, long = (ratios(PerturbedModelError(seed=3).structures(nominal(ndof))[0]) for ndof in (4, 9))
    np.testing.assert_array_equal(short["k"], long["k"][:4])
    other = build_chain(4, VanDerPol(), m=10.0, c=1.0, k=15.0, mu=0.75)
    np.testing.assert_array_equal(short["k"], PerturbedModelError(seed=3).structures(other)[0].parameters["k"] / 15.0)


def test_authors_draws_give_the_papers_table(shared):
    true, _ = PerturbedModelError(seed=43810, draws="authors").structures(nominal())
    with open(shared / "paper" / "perturbed_parameters.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 18
    for row in rows:
        name, dof = row["parameter"].rsplit("_", 1)
        # The table has two decimals.
        assert true.parameters[name][int(dof) - 1].item() == pytest.approx(float(row["true"]), abs=0.0051)


def test_structures_of_several_laws_have_model_errors_too():
    true, model = PerturbedModelError(seed=3).structures(braced())
    for kind, values in model.parameters.items():
        off = (true.parameters[kind] / values - 1.0).abs()
        assert ((off >= 0.05) & (off <= 0.1)).all() if kind != "m" else (off == 0).all()
    assert set(LinearModelError().structures(braced())[1].parameters) == {"m", "c", "k"}
