"""What structures do under the force of a record, one alone or many members side by side."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from beams import beam, deflection, response
from small_problems import excitation, measured, small_chain
from structures import braced, carried, hysteretic, modal

from pinn_cli.record.between_samples import Held
from pinn_cli.record.ensemble import Members, Replay, spread_of
from pinn_cli.record.free_run import NoFreeRunError, affordable, free_run, has_modes, linear_motion
from pinn_cli.record.record import Record
from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES, Response
from pinn_cli.record.simulation import simulate
from pinn_cli.record.steps import with_slow_followers
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.finite_elements import build_finite_elements
from pinn_cli.system.modes import modes_of
from pinn_cli.training.estimate import ParameterEstimate
from pinn_cli.training.prediction import drawn_structures, parameter_draws


def assert_same(found, expected, tolerance: float) -> None:
    for quantity in RESPONSE_QUANTITIES:
        values = getattr(expected, quantity)
        np.testing.assert_allclose(getattr(found, quantity), values, atol=tolerance * np.abs(values).max())


def truth_of(structure, measurements, hold):
    """By a method of order eight where the run is exact: a linear structure; else what the simulator said."""
    if structure.nonlinearity_name != "linear":
        return measurements.truth.response
    return simulate(structure, excitation(structure, 12.0, 513).force, measurements.record.time, hold, "dop853")


@pytest.mark.parametrize(("hold", "tolerance"), [("exact", 1e-6), ("zero_order", 1e-11)])
@pytest.mark.parametrize("nonlinearity", ["linear", "duffing", "van_der_pol"])
def test_the_true_chain_does_what_the_simulator_said(nonlinearity, hold, tolerance):
    """Of a held force the samples are all there is; one that is not held is interpolated."""
    structure = small_chain(nonlinearity)
    measurements = measured(structure, hold, samples=513)
    assert_same(free_run(structure, measurements.record), truth_of(structure, measurements, hold), tolerance)


@pytest.mark.parametrize(("hold", "tolerance"), [("exact", 1e-3), ("zero_order", 1e-10)])
def test_from_the_middle_on(hold, tolerance):
    structure = small_chain()
    measurements = measured(structure, hold, samples=513)
    truth, first = measurements.truth.response, 200
    found = free_run(structure, measurements.record, (truth.displacement[first], truth.velocity[first]), first=first)
    np.testing.assert_array_equal(found.time, truth.time[first:])
    assert_same(found, truth.part(first, len(truth.time)), tolerance)


def test_all_modes_of_a_beam_do_what_the_whole_model_does(tmp_path):
    """The highest one would take 600 steps per sample; far beyond the band it gets mass, and follows as it did."""
    M, K = beam(10)
    np.savez(tmp_path / "beam.npz", M=M.toarray(), K=K.toarray())
    structure = build_finite_elements(
        {"tip": deflection(10)}, "beam.npz", modes=20, damping_ratio=0.02, ground="1::2", base=tmp_path
    )
    rate, finer = 128.0, 24
    time = np.arange(2 * 128 * finer) / (finer * rate)
    force = np.sin(2.0 * np.pi * np.outer(time, [3.0, 17.0, 40.0])).sum(1) * np.sin(np.pi * time / 2.0) ** 2
    expected = [x[::finer, deflection(10) - 1] for x in response(M, K, 0.02, (deflection(10), force), 1 / finer / rate)]
    samples, blank = time[::finer], np.full((256, 1), np.nan)
    record = Record(samples, np.zeros((256, 1)), blank, blank, force[::finer, None], np.array([False]))
    found = free_run(structure, record, (np.zeros(20), np.zeros(20)))
    for quantity, values in zip(RESPONSE_QUANTITIES, expected, strict=True):
        error = getattr(found, quantity)[:, 0] - values
        assert np.sqrt(np.mean(error**2)) < 3e-3 * np.sqrt(np.mean(values**2))
    members = Members(
        {kind: values[None] for kind, values in structure.parameters_like(np.empty(0)).items()},
        np.zeros((1, 40)), np.zeros((0, 20)), 0,
    )  # fmt: skip
    assert np.nanmax(spread_of(members, structure, record, found).displacement) < 1e-9
    slow = with_slow_followers(structure, record.step)
    pushed = structure.parameters["m"].numpy()
    assert (slow.parameters["m"].numpy() > 1.0).any()
    np.testing.assert_allclose(slow.parameters["m"].numpy() * slow.with_ground, pushed * structure.with_ground)


def test_what_has_no_free_run_is_said():
    structure, record = small_chain(), measured(small_chain()).record
    massless = structure.with_parameters(m=structure.parameters["m"] * torch.tensor([1.0, 0.0, 1.0]))
    endless = structure.with_parameters(k=structure.parameters["k"] * np.inf)
    unforced = np.array([False, False, True])
    unknown = replace(record, force=record.force + np.array([0.0, np.nan, 0.0]), unforced=unforced)
    mu = small_chain("van_der_pol")
    unstable, coarse = mu.with_parameters(mu=-50.0 * mu.parameters["mu"]), measured(structure, samples=129).record
    for chain, under, said in (
        (massless, record, "a mass of it is zero"),
        (endless, record, "no finite number"),
        (structure, unknown, "the force on DOF 2 is unknown"),
        (unstable, coarse, "the structure is unstable: its free run overflows at "),
        (small_chain(k=1e9), coarse, r"more than \d+ evaluations per sample"),
    ):
        with pytest.raises(NoFreeRunError, match=said):
            free_run(chain, under, (np.full(3, 5.0), np.zeros(3)))


def test_a_long_record_is_cut_down_for_a_structure_that_takes_steps():
    record = measured(small_chain(), samples=513).record
    longer = replace(
        record,
        **{name: np.concatenate([getattr(record, name)] * 100) for name in QUANTITIES},
        time=record.step * np.arange(51300.0),
    )
    assert affordable(small_chain("linear"), longer) is longer
    assert affordable(small_chain(), record) is record
    part = affordable(small_chain(), longer)
    assert 100 < len(part.time) < len(longer.time)


TIME = np.linspace(3.0, 5.0, 41)
START = np.array([[0.1, -0.2, 0.05], [0.3, 0.1, -0.4]])


def force(at):
    """(M, 3), N: on the first and the last DOF, up to 0.8 of the Nyquist frequency."""
    out = np.zeros((len(at), 3))
    out[:, 0], out[:, 2] = np.sin(3.0 * at) + np.cos(50.0 * at), np.sin(17.0 * at + 0.3)
    return out


CHAINS = {
    "light": {"m": 10.0, "c": 1.0, "k": 1500.0},
    "undamped": {"m": 10.0, "c": 0.0, "k": 15.0},
    "overdamped": {"m": 10.0, "c": 900.0, "k": [15.0, 20.0, 30.0]},
    "stiff": {"m": 10.0, "c": 5.0, "k": [15.0, 1e5, 20.0]},
}


def moved(structure, load, start=START):
    modes = modes_of(structure)
    assert has_modes(modes)
    return linear_motion(modes, [(load, np.eye(structure.coordinates) / modes.m)], TIME, start)


@pytest.mark.parametrize("hold", ["exact", "zero_order"])
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name == "stiff" else name for name in CHAINS]
)
def test_it_is_that_of_a_method_of_order_eight(name, hold):
    structure = build_chain(3, Linear(), **CHAINS[name])
    load = force if hold == "exact" else Held(TIME, force(TIME))
    u, v = moved(structure, load)
    expected = simulate(structure, force, TIME, hold, "dop853", initial=START)
    for found, true in ((u, expected.displacement), (v, expected.velocity)):
        np.testing.assert_allclose(found, true, atol=(3e-5 if name == "stiff" else 1e-7) * np.abs(true).max())


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


STEP = 0.02


def pushed_oscillator(c: float, count: int, sources: np.ndarray, replay: Replay | None = None) -> Response:
    """Spread of so many oscillators of 1 kg and 25 N/m over 40 s, which nothing but these forces moves."""
    structure, still = build_chain(1, Linear(), m=1.0, c=c, k=25.0), np.zeros((2001, 1))
    blank = np.full_like(still, np.nan)
    record = Record(STEP * np.arange(2001), still, blank, blank, still, np.array([False]))
    parameters = {kind: np.tile(x, (count, 1)) for kind, x in structure.parameters_like(np.empty(0)).items()}
    members = Members(parameters, np.zeros((count, 2)), sources, 1, replay)
    return spread_of(members, structure, record, free_run(structure, record, None))


def test_white_forces_move_an_oscillator_as_the_textbook_says():
    found, again = (pushed_oscillator(2.0, 64, np.array([[0.7]])) for _ in range(2))
    # Of white noise with the covariance sigma^2 step delta(t): its variance over 2 c k, and over 2 c m of the velocity.
    variance = [float(np.mean(x[251:] ** 2)) for x in (found.displacement, found.velocity)]
    np.testing.assert_allclose(variance, [0.7**2 * STEP / (4.0 * 25.0), 0.7**2 * STEP / 4.0], rtol=0.1)
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
    history = np.sin(5.0 * np.arange(100_000) * STEP)[:, None]
    found = pushed_oscillator(0.2, 32, np.zeros((0, 1)), Replay.drawn(history, 1.0, 32, 0)).displacement
    # 1 / (c omega) of the textbook, root mean square, from 30 s on.
    assert np.sqrt(np.mean(found[1501:] ** 2)) == pytest.approx(1.0 / (0.2 * 5.0) / np.sqrt(2.0), rel=0.1)


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
