"""Parameters, priors and weights of the normal equations, the layout of the band, and averages over knot intervals."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from one_record import levels_of, problem_of, residuals_of, weights_of
from random_problems import noise_of, somewhere
from small_problems import small_chain
from structures import modal, shuffled

from pinn_cli.network.fourier import Fourier
from pinn_cli.network.spline import Spline, SplineNetwork
from pinn_cli.record.record import Record
from pinn_cli.scheme.problem import RINGS, Problem, TurningPoints
from pinn_cli.training.factors import frame
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.subdomains import INITIAL_CONDITIONS, Subdomains

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
    expected = [1.0 if p.unknown else spread**-2 for p in equations.problem.uncertain]
    assert len(set(expected)) == (1 if spread == 1.0 else 2)
    np.testing.assert_allclose(prior_of(equations, spread), np.diag(expected))


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


def test_residuals_vanish_at_padding_and_without_sensors():
    record = random_record(2)
    equations = posed(replace(record, displacement=np.full_like(record.force, np.nan)))
    residuals = residuals_of(equations, somewhere(equations))
    assert set(residuals) == {"velocity", "acceleration", "physics"}
    assert not residuals["velocity"][..., 0].any()
    assert not residuals["velocity"][equations.observation.mask == 0].any()
    assert residuals["physics"].shape == (equations.averages.count, 1, 2)
    assert not equations.motion.force(somewhere(equations))[equations.physics.mask == 0].any()


def test_no_more_than_a_window_of_a_long_motion_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame, "ROWS_AT_ONCE", 300)
    monkeypatch.setattr(frame, "KEPT_NUMBERS", 0)
    equations = posed(random_record(3), design=Spline(intervals=12))
    equations.assemble(equations.start(), noise_of(equations))
    (states,) = equations._kept_states.values()
    assert len(states.displacement) < equations.averages.count / 2


def test_a_parameter_of_modes_is_as_strong_as_it_pulls_at_them():
    """In the unit of the modes' equations: what it does to its connection, times the length of the shapes there."""
    structure = modal()
    spring = next(p for p in structure.every_parameter() if p.kind == "k" and p.index == 3)
    problem = Problem(structure, random_record(4), (replace(spring, prior_std=1.0),))
    network = Spline(intervals=8).build(problem.record, functions=problem.dynamics.size)
    equations = NormalEquations(network, problem)
    moved = somewhere(equations)
    strength = equations.motion.own_by_parameter(equations.physics, moved)[..., spring.index]
    rows = equations.motion.rows(equations.physics, moved).parameter
    pulled = rows[..., 0, :].square().sum((-1, -2)).sqrt()
    torch.testing.assert_close(strength.abs(), pulled, rtol=1e-9, atol=1e-12)


DEGREE = 6


def averages(intervals: int = 40, points: int = 6, degree: int = DEGREE, step: float = 0.05) -> Subdomains:
    """Knot intervals with so many points each, half way between the knots."""
    network = SplineNetwork(2, 0.0, intervals * points * step, intervals, degree, "exact", torch.float64)
    return Subdomains(network.segments(step * (torch.arange(intervals * points, dtype=torch.float64) + 0.5)))


@pytest.mark.parametrize("degree", [4, 6, 8])
@pytest.mark.parametrize("points", [3, 4, 7])
@pytest.mark.parametrize("intervals", [8, 9, 40])
def test_there_are_as_many_as_features_without_initial_conditions(intervals, points, degree):
    assert averages(intervals, points, degree).count == intervals + degree - INITIAL_CONDITIONS


def test_every_point_is_in_one_average():
    found = averages(points=5)
    sample, mask = found.segments.sample.numpy(), found.segments.mask.numpy() > 0
    np.testing.assert_array_equal(np.sort(sample[mask]), np.arange(40 * 5))
    # Averages follow each other in time.
    begins = [row[there].min() for row, there in zip(sample, mask, strict=True)]
    assert np.all(np.diff(begins) > 0)


def test_an_interval_without_points_has_no_average():
    network = SplineNetwork(1, 0.0, 20.0, 20, DEGREE, "exact", torch.float64)
    time = 0.25 * (torch.arange(80, dtype=torch.float64) + 0.5)
    found = Subdomains(network.segments(time[(time < 10.0) | (time > 11.0)]))
    assert 10 not in found.interval.tolist()
    assert found.count == 20 + DEGREE - INITIAL_CONDITIONS


def test_an_average_is_the_mean_times_the_root_of_its_points():
    found = averages(intervals=10, points=4)
    history = torch.randn(40, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    given = found(found.segments.gather(history))[:, 0]
    mask, sample = found.segments.mask > 0, found.segments.sample
    for row, index, there in zip(given, sample, mask, strict=True):
        inside = history[index[there]]
        torch.testing.assert_close(row, inside.mean(0) * len(inside) ** 0.5)


def test_averages_of_white_noise_are_white_with_its_variance():
    found = averages(intervals=400)
    rng = np.random.default_rng(0)
    white = torch.as_tensor(3.0 * rng.normal(size=(400 * 6, 50)))
    given = found(found.segments.gather(white))[:, 0].numpy()
    assert given.std() == pytest.approx(3.0, rel=0.02)
    # At the divided ends too, and no average knows of its neighbour.
    for end in (given[:3], given[-3:]):
        assert end.std() == pytest.approx(3.0, rel=0.2)
    correlation = np.mean(given[1:] * given[:-1]) / given.var()
    assert abs(correlation) < 3.0 / np.sqrt(given.size)


def test_averages_by_interval_are_those_of_undivided_intervals():
    found = averages(intervals=12, points=5)
    history = torch.randn(60, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    given = found.by_interval(found(found.segments.gather(history)))
    torch.testing.assert_close(given, history.reshape(12, 5, 3).mean(1) * 5**0.5)


def dynamic_stiffness_error(degree: int, per_period: float) -> float:
    """Relative error of the restoring force of a sine, with a spline that has its averaged accelerations right."""
    periods, points = 30, 32
    intervals = int(periods * per_period)
    network = SplineNetwork(1, 0.0, float(intervals), intervals, degree, "exact", torch.float64)
    time = (torch.arange(intervals * points, dtype=torch.float64) + 0.5) / points
    found = Subdomains(network.segments(time))
    omega = 2.0 * np.pi / per_period
    sine = torch.sin(omega * time)[:, None]

    # m u'' + c u' + k u = f with the sine its exact solution: far from resonance, so that k is told.
    def rows(values: torch.Tensor) -> np.ndarray:
        local = found(values)[:, 0].numpy()
        out = np.zeros((found.count, network.count))
        np.put_along_axis(out, found.segments.feature.numpy(), local, axis=1)
        return out

    curvature, value = rows(found.segments.orders[2]), rows(found.segments.orders[0])
    right = found(found.segments.gather(sine))[:, 0, 0].numpy()
    weights = np.linalg.lstsq(np.vstack((curvature, 1e-6 * value)), np.r_[-(omega**2) * right, 1e-6 * right], None)[0]
    middle = slice(found.count // 3, 2 * found.count // 3)
    carried = (value @ weights)[middle]
    pure = np.stack((right, found(found.segments.gather(torch.cos(omega * time)[:, None]))[:, 0, 0].numpy()), 1)[middle]
    trend = np.stack((np.ones(len(pure)), np.arange(len(pure))), 1)
    return abs(np.linalg.lstsq(np.hstack((pure, trend)), carried, None)[0][0] - 1.0)


def test_the_dynamic_stiffness_is_off_by_the_power_of_the_degree():
    """By (f / (r - f))^degree, twice with both images: the module's own claim, for even degrees."""
    for degree, per_period in ((4, 4.0), (4, 6.0), (6, 4.0), (6, 6.0)):
        ratio = 1.0 / (per_period - 1.0)
        assert dynamic_stiffness_error(degree, per_period) == pytest.approx(ratio**degree, rel=0.7)


def test_averages_about_turns_count_for_less_and_the_others_as_ever():
    found, time = averages(), 0.05 * (torch.arange(240, dtype=torch.float64) + 0.5)
    turns = TurningPoints(np.array([3.01, 6.0, 6.4]), level=2.0, looser=10.0, discrepancy=1.0)
    near = turns.near(found.times(time), 0.3)
    distance = np.abs(found.times(time)[:, None] - turns.time).min(axis=1)
    np.testing.assert_array_equal(near, distance < RINGS * 0.3)
    assert 0.2 < near.mean() < 0.6
    values = found.segments.gather(torch.randn((240, 2), generator=torch.Generator().manual_seed(1)).double())
    loosened = found.loosened(torch.as_tensor(near), turns.looser)
    torch.testing.assert_close(loosened(values)[near], found(values)[near] / 10.0)
    assert torch.equal(loosened(values)[~near], found(values)[~near])
    assert not TurningPoints(np.zeros(0), 1.0, 1.0, 1.0).near(np.arange(5.0), 0.3).any()
