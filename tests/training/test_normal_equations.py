"""Parameters, priors and weights of the normal equations, steps to bounds, and the layout of the band."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from one_record import factored, levels_of, problem_of, residuals_of, shared, weights_of
from random_problems import noise_of, somewhere
from small_problems import small_chain
from structures import braced, hysteretic, shuffled

from pinn_cli.network.fourier import Fourier
from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Record
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.functions import Inputs
from pinn_cli.training.covariance import ReadoutPosterior
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.normal_matrix.dissection import Dissection, Grid

SAMPLES = 21


def random_record(ndof: int) -> Record:
    """Histories without physics: accelerometers, displacement sensor on the first DOF, velocity sensor on the last."""
    rng = np.random.default_rng(ndof)
    motion = np.full((3, SAMPLES, ndof), np.nan)
    motion[0, :, 0], motion[1, :, -1] = rng.normal(size=(2, SAMPLES))
    motion[2] = rng.normal(size=(SAMPLES, ndof))
    forced = np.arange(ndof) % 2 == 0
    force = np.where(forced, rng.normal(size=(SAMPLES, ndof)), 0.0)
    return Record(0.3 * np.arange(SAMPLES) + 2.0, *motion, force, ~forced)


def posed(record, design=None, through="derivative", kinds=()) -> NormalEquations:
    return of_structure(small_chain(ndof=record.ndof), design or Spline(intervals=5), through, kinds, record)


def of_structure(structure, design, through="derivative", kinds=None, record=None) -> NormalEquations:
    record = record or random_record(structure.ndof)
    moving = [p for p in structure.every_parameter() if kinds is None or p.kind in kinds]
    uncertain = tuple(replace(p, prior_std=0.05 * p.prescribed) for p in moving)
    return NormalEquations(design.build(record), Problem(structure, record, uncertain, through))


def prior_of(equations: NormalEquations, spread: float = 1.7) -> np.ndarray:
    (prior,) = problem_of(equations).priors(levels_of(noise_of(equations), spread))
    return prior


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
    noise, found = noise_of(plain), []
    for equations in (plain, dissected):
        point = somewhere(equations)
        system = equations.assemble(point, noise, prior_of(equations))
        posterior, whole = ReadoutPosterior(equations, point, factored(system)), shared(system)
        found.append(
            (
                *whole.factor().step(whole),
                *posterior.functions(equations.observation),
                posterior.force(equations.physics),
            )
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
    noise = noise_of(equations)
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


@pytest.mark.parametrize("continuity", ["exact", "penalised"])
@pytest.mark.parametrize("kind", [Spline, Fourier])
def test_the_network_moves_as_the_point_says(kind, continuity):
    equations = posed(random_record(3), design=kind(continuity=continuity))
    point = somewhere(equations)
    equations.network.readout.data = equations.readout(point)
    expected = equations.network(equations.target.observation_time)
    for given, wanted in zip(equations.flat_states(equations.observation, point)[:3], expected[:3], strict=True):
        torch.testing.assert_close(given, wanted)


def test_unobserved_and_unenforced_dofs_weigh_nothing():
    record = random_record(3)
    record.force[:, 2] = np.nan
    equations = posed(record, through="both")
    weights = weights_of(equations, noise_of(equations))
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
    residuals = residuals_of(equations, somewhere(equations))
    assert set(residuals) == {"velocity", "acceleration", "physics"}
    assert not residuals["velocity"][..., 0].any()
    assert not residuals["velocity"][equations.observation.mask == 0].any()
    assert residuals["physics"].shape == (equations.averages.count, 1, 2)
    assert not equations.motion.force(somewhere(equations))[equations.physics.mask == 0].any()
