"""Banded normal equations against dense Jacobians by automatic differentiation, and the layout of the band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from one_record import factored, levels_of, problem_of, shared
from scipy.sparse import csr_matrix
from small_problems import NONLINEARITIES, small_chain
from structures import braced, hysteretic, modal, shuffled

from pinn_cli.model.knowledge import EndState, Levels
from pinn_cli.network.fourier import Fourier
from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Record
from pinn_cli.scheme.joint_prior import JointPrior
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.functions import Inputs
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.band.bordered import BorderedSystem
from pinn_cli.training.band.dissection import Dissection, Grid
from pinn_cli.training.band.normal_equations import NormalEquations
from pinn_cli.training.band.point import Point
from pinn_cli.training.band.posterior import ReadoutPosterior
from pinn_cli.training.noise_model import NoiseModel

SAMPLES = 21


def random_record(
    ndof: int, hold: str = "band_limited", unknown_force: int | None = None, sensors: str = "all"
) -> Record:
    """Histories without physics: accelerometers, displacement sensor on the first DOF, velocity sensor on the last."""
    rng = np.random.default_rng(ndof)
    nothing = np.full((SAMPLES, ndof), np.nan)
    force, acceleration = np.zeros((SAMPLES, ndof)), rng.normal(size=(SAMPLES, ndof))
    displacement, velocity = nothing.copy(), nothing.copy()
    forced = np.arange(ndof) % 2 == 0
    force[:, forced] = rng.normal(size=(SAMPLES, int(forced.sum())))
    if unknown_force is not None:
        force[:, unknown_force], forced[unknown_force] = np.nan, True
    if sensors != "acceleration":
        displacement[:, 0], velocity[:, -1] = rng.normal(size=SAMPLES), rng.normal(size=SAMPLES)
    if sensors == "motion":
        acceleration = nothing
    return Record(0.3 * np.arange(SAMPLES) + 2.0, displacement, velocity, acceleration, force, ~forced, hold)


def every_other(structure, kinds) -> tuple[Parameter, ...]:
    """Some parameters of each kind, in an order of their own, with spreads of their own."""
    chosen = [
        (kind, dof)
        for kind in kinds
        for dof in range(structure.ndof)
        if (dof + len(kind)) % 3 or dof == structure.ndof - 1
    ]
    return tuple(
        Parameter(
            kind,
            dof,
            float(structure.parameters[kind][dof]),
            (0.05 + 0.01 * i) * float(structure.parameters[kind][dof]),
        )
        for i, (kind, dof) in enumerate(reversed(chosen))
    )


def posed(record, nonlinearity="duffing", design=None, through="derivative", kinds=()) -> NormalEquations:
    structure = small_chain(nonlinearity, ndof=record.ndof)
    problem = Problem(structure, record, every_other(structure, kinds), through)
    return NormalEquations((design or Spline(intervals=5)).build(record), problem)


def noise_of(record: Record, continuity: float = 0.3) -> NoiseModel:
    levels = 0.5 + 0.1 * np.arange(record.ndof)
    response = {
        q: np.where(record.sensors(q), levels * s, np.nan)
        for q, s in {"displacement": 0.7, "velocity": 0.9, "acceleration": 1.1}.items()
    }
    return NoiseModel(response, np.where(record.sensors("force"), levels, np.nan), 0.4, continuity)


def somewhere(equations: NormalEquations) -> Point:
    generator = torch.Generator().manual_seed(5)
    start = equations.start()
    return Point(
        *(0.3 * torch.randn(len(x), generator=generator, dtype=x.dtype) for x in (start.unknowns, start.parameters))
    )


def dense(system: BorderedSystem) -> tuple[np.ndarray, np.ndarray]:
    """Hessian and gradient."""
    border = csr_matrix(system.border).toarray()
    hessian = np.block([[system.band.dense(), border], [border.T, system.corner]])
    return hessian, np.concatenate((system.gradient, system.corner_gradient))


def autograd_equations(
    equations: NormalEquations, point: Point, noise: NoiseModel, prior: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same by differentiating every weighted residual."""
    weights = equations.weights(noise)

    def weighted(unknowns, parameters):
        residuals = equations.residuals(Point(unknowns, parameters))
        rows = [(r * weights[name].sqrt()).flatten() for name, r in residuals.items()]
        states = [known.residuals(unknowns, parameters).flatten() for known in equations.states_known]
        return torch.cat([*rows, *states])

    inputs = (point.unknowns, point.parameters)
    jacobian = torch.cat(torch.autograd.functional.jacobian(weighted, inputs, vectorize=True), -1)
    ridge = torch.as_tensor(equations.ridge).to(inputs[0]).expand_as(inputs[0])
    believed = torch.block_diag(torch.diag(ridge), torch.as_tensor(prior))
    gradient = jacobian.T @ weighted(*inputs) + believed @ torch.cat(inputs)
    return (jacobian.T @ jacobian + believed).numpy(), gradient.detach().numpy()


def prior_of(equations: NormalEquations, spread: float = 1.7) -> np.ndarray:
    (prior,) = problem_of(equations).priors(levels_of(noise_of(equations.problem.record), spread))
    return prior


def assert_agrees(equations: NormalEquations, noise: NoiseModel | None = None, spread: float = 1.7) -> None:
    point, noise = somewhere(equations), noise or noise_of(equations.problem.record)
    prior = prior_of(equations, spread)
    hessian, gradient = dense(equations.assemble(point, noise, prior))
    expected_hessian, expected_gradient = autograd_equations(equations, point, noise, prior)
    scale = np.sqrt(np.diag(expected_hessian))
    np.testing.assert_allclose(hessian / scale / scale[:, None], expected_hessian / scale / scale[:, None], atol=1e-10)
    size = np.abs(expected_gradient / scale).max()
    np.testing.assert_allclose(gradient / scale / size, expected_gradient / scale / size, atol=1e-9)


@pytest.mark.parametrize("ndof", [1, 2, 3])
@pytest.mark.parametrize("through", ["derivative", "observer", "both"])
@pytest.mark.parametrize("continuity", ["exact", "penalised"])
@pytest.mark.parametrize("kind", [Spline, Fourier])
def test_every_network_and_observation(kind, continuity, through, ndof):
    size = {"intervals": 5} if kind is Spline else {"harmonics": 3}
    design = kind(continuity=continuity, **size)
    assert_agrees(posed(random_record(ndof), "duffing", design, through, ("k", "c", "kappa")))


@pytest.mark.parametrize("ndof", [1, 2, 3])
@pytest.mark.parametrize("through", ["derivative", "observer", "both"])
@pytest.mark.parametrize("nonlinearity", NONLINEARITIES)
def test_every_nonlinearity_with_its_own_parameters(nonlinearity, through, ndof):
    kinds = [name for name in small_chain(nonlinearity).parameters if name != "m"]
    assert_agrees(posed(random_record(ndof), nonlinearity, None, through, kinds))


@pytest.mark.parametrize("through", ["derivative", "observer", "both"])
@pytest.mark.parametrize("ndof", [1, 2, 3])
def test_uncertain_masses(ndof, through):
    assert_agrees(posed(random_record(ndof), through=through, kinds=("m", "k", "kappa")))


@pytest.mark.parametrize("through", ["derivative", "observer", "both"])
@pytest.mark.parametrize("sensors", ["all", "acceleration", "motion"])
@pytest.mark.parametrize("unknown_force", [None, 0, 1, 2])
@pytest.mark.parametrize("hold", ["band_limited", "zero_order_hold"])
def test_every_record(hold, unknown_force, sensors, through):
    assert_agrees(posed(random_record(3, hold, unknown_force, sensors), "duffing", None, through, ("k",)))


def test_no_uncertain_parameters():
    assert_agrees(posed(random_record(3), through="both"))


def of_structure(structure, design, through="derivative") -> NormalEquations:
    record = random_record(structure.ndof)
    uncertain = tuple(replace(p, prior_std=0.05 * p.prescribed) for p in structure.every_parameter())
    return NormalEquations(design.build(record), Problem(structure, record, uncertain, through))


@pytest.mark.parametrize("through", ["derivative", "both"])
@pytest.mark.parametrize("design", [Spline(intervals=5), Fourier(harmonics=3)], ids=["spline", "fourier"])
@pytest.mark.parametrize("structure", [braced, shuffled])
def test_structures_that_are_no_chains(structure, design, through):
    assert_agrees(of_structure(structure(), design, through))


INPUTS = {
    "memory": (hysteretic, Inputs(rate=4.0)),
    "ground": (braced, Inputs(True, edge=5.0)),
    "ground, relative sensors": (braced, Inputs(True, False, edge=5.0)),
    "forces": (braced, Inputs(forces=(0, 2), correlation_time=0.3, rate=4.0)),
    "all": (hysteretic, Inputs(True, True, (1,), 0.3, 4.0, 5.0)),
    "modes": (modal, Inputs(True, True, edge=5.0, loads=(0, 1, 3))),
}


@pytest.mark.parametrize("design", [Spline(intervals=5), Fourier(harmonics=3)], ids=["spline", "fourier"])
@pytest.mark.parametrize("case", INPUTS)
def test_functions_beside_the_motion(case, design):
    of, inputs = INPUTS[case]
    structure = of()
    record = random_record(structure.ndof)
    if inputs.ground:
        shaken = np.random.default_rng(1).normal(size=SAMPLES)
        record = replace(record, ground_acceleration=shaken, frame="absolute" if inputs.absolute else "relative")
    uncertain = tuple(replace(p, prior_std=0.05 * abs(p.prescribed)) for p in structure.every_parameter())
    problem = Problem(structure, record, uncertain, inputs=inputs)
    dynamics = problem.dynamics
    equations = NormalEquations(design.build(record, functions=dynamics.size), problem)
    noise, more = noise_of(record), (0, dynamics.size - record.ndof)
    if inputs.ground:
        noise.response["ground_acceleration"] = np.array([0.8])
    driven = np.full(dynamics.size, np.nan)
    driven[dynamics.ground], driven[dynamics.forces], driven[dynamics.loads] = 0.6, 1.3, 0.9
    force = np.pad(noise.force, more, constant_values=np.nan) if more[1] > 0 else noise.force
    if inputs.loads:
        noise.response["force"], force = 0.5 + 0.1 * np.arange(4), np.full(dynamics.size, np.nan)
    assert_agrees(equations, replace(noise, force=force, innovation=driven))


@pytest.mark.parametrize("structure", [small_chain(ndof=3), braced(), hysteretic()])
def test_a_motion_that_goes_on(structure):
    """Its first state is tied to the readout, and what is known of it to the parameters."""
    problem = of_structure(structure, Spline(intervals=5)).problem
    problem = replace(problem, inputs=Inputs(rate=4.0) if len(structure.memory) else Inputs())
    p, states = len(problem.uncertain), 2 * structure.coordinates + len(structure.memory)
    rng = np.random.default_rng(3)
    root = rng.normal(size=(p + states, 2 * (p + states)))
    unit = np.concatenate(([q.prior_std for q in problem.uncertain], rng.uniform(0.5, 2.0, states)))
    correlation = np.corrcoef(root)
    covariance = correlation * np.outer(unit, unit)
    state = EndState(0.0, rng.normal(size=states), covariance[p:, p:], covariance[p:, :p])
    nothing = np.zeros(p)
    prior = JointPrior(correlation[:p, :p], unit[:p], nothing, nothing, Levels({}, np.nan, 1.0, np.nan, np.nan))
    problem = replace(problem, prior=prior, initial_state=state)
    network = Spline(intervals=5).build(problem.record, functions=problem.dynamics.size)
    equations, record = NormalEquations(network, problem), problem.record
    more = (0, problem.dynamics.size - record.ndof)
    noise = noise_of(record)
    noise = replace(noise, force=np.pad(noise.force, more, constant_values=np.nan) if more[1] > 0 else noise.force)
    expected = np.linalg.inv(correlation)
    np.testing.assert_allclose(prior_of(equations, 1.0), expected, atol=1e-6 * np.abs(expected).max())
    assert_agrees(equations, noise, 1.0)


@pytest.mark.parametrize("structure", [small_chain(ndof=12), shuffled(12), braced(), hysteretic()])
def test_the_order_of_elimination_changes_nothing(structure):
    problem = of_structure(structure, Spline(intervals=20)).problem
    inputs = Inputs(rate=4.0) if len(structure.memory) else Inputs()
    problem = replace(problem, inputs=inputs)
    network = Spline(intervals=20).build(problem.record, functions=problem.dynamics.size)
    plain, dissected = NormalEquations(network, problem), NormalEquations(network, problem)
    grid = Grid(network.count, problem.dynamics.size, network.degree, dissected.pattern.reach, len(problem.uncertain))
    assert plain.layout.dissection.best.how != "halves"
    dissected.layout.dissection = Dissection(grid, largest=20)
    noise, found = noise_of(problem.record), []
    driven = np.pad(noise.force, (0, problem.dynamics.size - len(noise.force)), constant_values=0.5)
    for equations in (plain, dissected):
        point = somewhere(equations)
        system = equations.assemble(point, replace(noise, force=driven), prior_of(equations))
        posterior, whole = ReadoutPosterior(equations, point, factored(system)), shared(system)
        found.append(
            (*whole.factor().step(whole), *posterior.functions(equations.observation), posterior.force_residual())
        )
    assert len(system.tree.fronts) > 4
    for pair in zip(*found, strict=True):
        expected, given = (np.asarray(x) for x in pair)
        np.testing.assert_allclose(given, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("design", [Spline(intervals=5), Fourier(harmonics=3)], ids=["spline", "fourier"])
def test_a_chain_in_disorder_has_the_band_of_a_chain(design):
    in_order, mixed = of_structure(small_chain(ndof=6), design), of_structure(shuffled(6), design)
    assert mixed.layout.half_width == in_order.layout.half_width


def some_unknown(equations: NormalEquations, positive: bool = False) -> NormalEquations:
    """The same with every other parameter unknown."""
    uncertain = tuple(
        replace(p, unknown=bool(i % 2), positive=positive) for i, p in enumerate(equations.problem.uncertain)
    )
    return NormalEquations(equations.network, replace(equations.problem, uncertain=uncertain))


@pytest.mark.parametrize("spread", [0.01, 1.0, 30.0])
def test_the_spread_is_that_of_believed_parameters_alone(spread):
    equations = some_unknown(posed(random_record(3), kinds=("k", "c", "kappa")))
    noise = noise_of(equations.problem.record)
    expected = [1.0 if p.unknown else spread**-2 for p in equations.problem.uncertain]
    assert len(set(expected)) == (1 if spread == 1.0 else 2)
    np.testing.assert_allclose(prior_of(equations, spread), np.diag(expected))
    # In the Hessian, in its gradient and in the loss.
    point = somewhere(equations)
    given, without = (equations.assemble(point, noise, prior_of(equations, n)) for n in (spread, 1e9))
    believed = np.array([not p.unknown for p in equations.problem.uncertain])
    added = believed * spread**-2
    np.testing.assert_allclose(given.corner - without.corner, np.diag(added), atol=1e-9 * added.max())
    np.testing.assert_allclose(
        given.corner_gradient - without.corner_gradient, added * point.parameters.numpy(), atol=1e-9 * added.max()
    )
    prior = float((torch.tensor(expected) * point.parameters.square()).sum())
    assert equations.losses(point, noise, prior_of(equations, spread))["prior"] == pytest.approx(prior)
    whole = problem_of(equations).losses(point, levels_of(noise, spread))
    assert whole["prior"] == pytest.approx(prior)


def test_room_below_is_the_way_to_zero():
    equations = some_unknown(posed(random_record(3), kinds=("k", "c", "kappa")), positive=True)
    point = somewhere(equations)
    low = {name: values.clone() for name, values in equations.parameters(point).items()}
    room = problem_of(equations).room_below(point)
    assert np.all(room < 0)
    for parameter, step in zip(equations.problem.uncertain, room, strict=True):
        low[parameter.kind][parameter.index] += parameter.prior_std * step
        assert low[parameter.kind][parameter.index] == pytest.approx(0.0, abs=1e-12)
    free = some_unknown(posed(random_record(3), kinds=("k",)))
    assert np.all(problem_of(free).room_below(somewhere(free)) == -np.inf)


@pytest.mark.parametrize("seed", range(3))
def test_a_step_to_a_bound_ends_at_the_bound(seed):
    """Exactly, from wherever it comes, and back again to exactly no room."""
    equations = some_unknown(posed(random_record(3), kinds=("k", "c", "kappa")), positive=True)
    whole, rng = problem_of(equations), np.random.default_rng(seed)
    point, count = equations.start(), len(equations.lower)
    nowhere = np.zeros(equations.layout.size)
    for _ in range(20):
        room, held = whole.room_below(point), rng.random(count) < 0.5
        point = whole.moved(point, (nowhere, np.where(held, room, rng.exponential(size=count))))
        parameters = point.parameters.numpy()
        np.testing.assert_array_equal(parameters[held], equations.lower[held])
        np.testing.assert_array_equal(whole.room_below(point)[held], 0.0)
        assert np.all(parameters >= equations.lower)


def test_without_bounds_a_step_is_a_sum():
    equations = posed(random_record(3), kinds=("k",))
    point = somewhere(equations)
    step = np.full(equations.layout.size, 0.1), np.full(len(equations.lower), -5.0)
    moved = problem_of(equations).moved(point, step)
    torch.testing.assert_close(moved.unknowns, point.unknowns + 0.1)
    torch.testing.assert_close(moved.parameters, point.parameters - 5.0)


@pytest.mark.parametrize("design", [Spline(intervals=5), Fourier(harmonics=3)], ids=["spline", "fourier"])
def test_more_dofs_than_a_chunk_holds(monkeypatch, design):
    monkeypatch.setattr("pinn_cli.training.band.equation_rows.CHUNK", 1)
    assert_agrees(posed(random_record(3), "duffing", design, "both", ("k",)))


def test_parameters_at_a_point():
    equations = posed(random_record(3), kinds=("k", "c"))
    point = somewhere(equations)
    expected = {name: value.clone() for name, value in equations.dynamics.structure.parameters.items()}
    for parameter, x in zip(equations.problem.uncertain, point.parameters, strict=True):
        expected[parameter.kind][parameter.index] += parameter.prior_std * x
    given = equations.parameters(point)
    assert list(given) == list(expected)
    for name, value in expected.items():
        torch.testing.assert_close(given[name], value)


@pytest.mark.parametrize("continuity", ["exact", "penalised"])
@pytest.mark.parametrize("kind", [Spline, Fourier])
def test_the_network_moves_as_the_point_says(kind, continuity):
    equations = posed(random_record(3), design=kind(continuity=continuity))
    point = somewhere(equations)
    equations.network.readout.data = equations.readout(point)
    expected = equations.network(equations.target.observation_time)
    for given, wanted in zip(equations.flat_states(equations.observation, point)[:3], expected[:3], strict=True):
        torch.testing.assert_close(given, wanted)


def test_losses_are_what_the_gradient_is_of():
    equations = posed(random_record(2), through="both", kinds=("k",))
    point, noise, prior = somewhere(equations), noise_of(equations.problem.record), prior_of(equations)
    system = equations.assemble(point, noise, prior)
    direction = torch.ones_like(point.unknowns), torch.ones_like(point.parameters)
    step = 1e-6
    losses = [
        sum(equations.losses(point.moved(tuple(s * x for x in direction)), noise, prior).values())
        for s in (step, -step)
    ]
    expected = 2.0 * (system.gradient.sum() + system.corner_gradient.sum())
    assert (losses[0] - losses[1]) / (2.0 * step) == pytest.approx(expected, rel=1e-6)


def test_unobserved_and_unenforced_dofs_weigh_nothing():
    record = random_record(3, unknown_force=2)
    weights = posed(record, through="both").weights(noise_of(record))
    assert {name: (w > 0).tolist() for name, w in weights.items()} == {
        "displacement": [True, False, False],
        "velocity": [False, False, True],
        "acceleration": [True, True, True],
        "observer": [True, True, False],
        "physics": [True, True, False],
    }


def test_a_splines_band_does_not_grow_with_the_record():
    short, long = (posed(random_record(3), design=Spline(intervals=n)).layout for n in (5, 12))
    assert short.half_width == long.half_width == 6 * 3 + 2


def test_global_features_are_eliminated_along_the_structure():
    best = posed(random_record(60), design=Fourier(harmonics=20)).layout.dissection.best
    assert best.axis == "functions"


@pytest.mark.parametrize("design", [Spline(intervals=5), Fourier(harmonics=3)])
@pytest.mark.parametrize("ndof", [1, 2, 6])
def test_every_weight_has_one_place(design, ndof):
    layout = posed(random_record(ndof), design=design).layout
    feature, dof = np.meshgrid(np.arange(layout.count), np.arange(ndof), indexing="ij")
    place = layout.positions(feature, dof)
    assert sorted(place.flatten()) == list(range(layout.size))
    weights = layout.weights(torch.arange(layout.size))
    np.testing.assert_array_equal(weights.numpy(), place)


def test_residuals_vanish_at_padding_and_without_sensors():
    record = random_record(2)
    equations = posed(replace(record, displacement=np.full_like(record.force, np.nan)))
    residuals = equations.residuals(somewhere(equations))
    assert set(residuals) == {"velocity", "acceleration", "physics"}
    assert not residuals["velocity"][..., 0].any()
    assert not residuals["velocity"][equations.observation.mask == 0].any()
    assert residuals["physics"].shape == (equations.averages.count, 1, 2)
    assert not equations.force_residual(somewhere(equations))[equations.physics.mask == 0].any()
