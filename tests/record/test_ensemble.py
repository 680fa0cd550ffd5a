"""Many members side by side against one simulation each, and white forces against the textbook's variance."""

from dataclasses import replace

import numpy as np
import pytest
from small_problems import small_chain
from structures import braced, carried, hysteretic, modal

from pinn_cli.record.ensemble import Members, Replay, spread_of
from pinn_cli.record.free_run import free_run
from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.training.estimate import ParameterEstimate
from pinn_cli.training.prediction import drawn_structures, parameter_draws

SAMPLES = 151
MOVED = 0.1 * np.sin(np.outer(np.linspace(0.0, 3.0, SAMPLES), [2.0, 3.0]))


def record_of(structure, ground: bool = False, **settings) -> Record:
    n, time = structure.ndof, np.linspace(0.0, 3.0, SAMPLES)
    force = np.zeros((SAMPLES, n))
    force[:, 0] = np.sin(2.0 * time) + 0.3 * np.sin(5.0 * time + 1.0)
    blank = np.full((SAMPLES, n), np.nan)
    shaken = {"ground_acceleration": 0.5 * np.cos(3.0 * time)} if ground else {}
    return Record(time, np.zeros((SAMPLES, n)), blank, blank, force, np.arange(n) > 0, **shaken, **settings)


@pytest.mark.parametrize(
    ("structure", "settings"),
    [
        (small_chain("duffing"), {}),
        (small_chain("linear"), {"intersample": "zero_order_hold"}),
        (braced(), {"ground": True, "frame": "relative"}),
        (hysteretic(), {"ground": True}),
        (carried(), {"ground": True, "supports": {"support_displacement": MOVED}, "support_names": ("a", "b")}),
        (modal(), {"ground": True}),
        (modal(), {"ground": True, "frame": "relative"}),
    ],
    ids=["chain", "held", "braced", "hysteretic", "carried", "modal", "modal_relative"],
)
def test_members_are_simulations(structure, settings):
    record, random = record_of(structure, **settings), np.random.default_rng(0)
    size = 2 * structure.coordinates + len(structure.memory)
    start = 0.05 * random.standard_normal((3, size))
    parameters = {
        kind: value * (1.0 + 0.1 * random.uniform(-1.0, 1.0, (3, len(value))))
        for kind, value in structure.parameters_like(np.empty(0)).items()
    }
    about = free_run(structure, record, None)
    members = Members(parameters, start, np.zeros((0, structure.coordinates)), 0)
    found = spread_of(members, structure, record, about)
    n = structure.coordinates
    single = []
    for i in range(3):
        values = {p: parameters[p.kind][i, p.index] for p in structure.every_parameter()}
        parts = [start[i, :n], start[i, n : 2 * n], *([start[i, 2 * n :]] if len(structure.memory) else [])]
        single.append(free_run(structure.with_values(values), record, parts))
    for quantity in RESPONSE_QUANTITIES:
        distance = [getattr(each, quantity) - getattr(about, quantity) for each in single]
        expected = np.sqrt(np.mean(np.square(distance), axis=0))
        np.testing.assert_allclose(
            getattr(found, quantity), expected, rtol=2e-3, atol=1e-4 * expected.max(), err_msg=quantity
        )


def test_white_forces_move_an_oscillator_as_the_textbook_says():
    structure = build_chain(1, Linear(), m=1.0, c=2.0, k=25.0)
    time = np.linspace(0.0, 40.0, 2001)
    still = np.zeros((2001, 1))
    record = Record(time, still, np.full_like(still, np.nan), np.full_like(still, np.nan), still, np.array([False]))
    sigma, step = 0.7, record.step
    parameters = {kind: np.tile(x, (64, 1)) for kind, x in structure.parameters_like(np.empty(0)).items()}
    members = Members(parameters, np.zeros((64, 2)), np.array([[sigma]]), 1)
    found = spread_of(members, structure, record, free_run(structure, record, None))
    # Of white noise with the covariance sigma^2 step delta(t): its variance over 2 c k, and over 2 c m of the velocity.
    late = time > 5.0
    variance = [float(np.mean(x[late] ** 2)) for x in (found.displacement, found.velocity)]
    np.testing.assert_allclose(variance, [sigma**2 * step / (4.0 * 25.0), sigma**2 * step / 4.0], rtol=0.1)
    again = spread_of(members, structure, record, free_run(structure, record, None))
    np.testing.assert_array_equal(found.displacement, again.displacement)


def test_a_force_is_replayed_from_other_places_on():
    history = np.column_stack((np.arange(5.0), -np.arange(5.0)))
    replay = Replay(history, 0.5, np.array([0, 3]), np.array([1.0, -1.0]))
    found = replay.at(np.arange(12))
    np.testing.assert_allclose(found[:, 0, 0], [0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4, 3.5, 3, 2.5])
    np.testing.assert_allclose(found[:, 1, 0], [-3, -3.5, -4, -3.5, -3, -2.5, -2, -1.5, -1, -0.5, 0, -0.5])
    np.testing.assert_array_equal(found[..., 1], -found[..., 0])
    drawn = Replay.drawn(history, 1.0, 400, 0)
    assert set(drawn.first) == set(range(8))
    assert 150 < (drawn.sign > 0).sum() < 250


def test_a_replayed_resonance_moves_an_oscillator_more_than_white_noise_of_its_size():
    structure = build_chain(1, Linear(), m=1.0, c=0.2, k=25.0)
    time = np.linspace(0.0, 40.0, 2001)
    still = np.zeros((2001, 1))
    record = Record(time, still, np.full_like(still, np.nan), np.full_like(still, np.nan), still, np.array([False]))
    parameters = {kind: np.tile(x, (32, 1)) for kind, x in structure.parameters_like(np.empty(0)).items()}
    history = np.sin(5.0 * np.arange(100_000) * record.step)[:, None]
    replay = Replay.drawn(history, 1.0, 32, 0)
    members = Members(parameters, np.zeros((32, 2)), np.zeros((0, 1)), 1, replay)
    found = spread_of(members, structure, record, free_run(structure, record, None)).displacement
    late = time > 30.0  # 1 / (c omega) of the textbook, root mean square
    assert np.sqrt(np.mean(found[late] ** 2)) == pytest.approx(1.0 / (0.2 * 5.0) / np.sqrt(2.0), rel=0.1)


def found(structure, relative: float) -> list[ParameterEstimate]:
    return [
        ParameterEstimate(replace(p, positive=True), p.prescribed, relative * p.prescribed)
        for p in structure.every_parameter()
        if p.kind in ("c", "k")
    ]


def test_draws_have_the_deviations_and_the_correlation():
    structure = small_chain("linear")
    estimates = found(structure, 0.1)
    correlation = np.full((6, 6), 0.5) + 0.5 * np.eye(6)
    draws = parameter_draws(estimates, correlation, 20_000, 0)
    np.testing.assert_allclose(draws.std(axis=0), [p.std for p in estimates], rtol=0.03)
    np.testing.assert_allclose(np.corrcoef(draws.T), correlation, atol=0.03)
    every = drawn_structures(structure, estimates, draws)
    np.testing.assert_array_equal(every["k"], draws[:, [p.kind == "k" for p in estimates]])
    np.testing.assert_array_equal(every["m"][7], structure.parameters["m"])
    wide = parameter_draws(found(structure, 3.0), correlation, 1000, 0)
    assert wide.min() == 0.0
    assert parameter_draws(estimates, None, 10, 0) is None
    assert parameter_draws([], None, 10, 0).shape == (10, 0)
