import pickle
import re
from collections.abc import Callable

import numpy as np
import pytest
from calls import refusal
from scipy.linalg import expm
from small_problems import small_chain
from storeys import chain_matrix

from pinn_cli.record import runge_kutta as one_by_one
from pinn_cli.record.excitation import BandedNoise, Impulse
from pinn_cli.record.response import Response
from pinn_cli.record.runge_kutta import LEAST_STEPS, runge_kutta_step, shot
from pinn_cli.record.simulation import OverflowsError, Simulation, StateEquation, simulate
from pinn_cli.record.steps import substeps_needed
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Linear, PowerDamping, VanDerPol
from pinn_cli.system.structure import Structure

DURATION = 8.0
CHAINS = {
    "linear": build_chain(3, Linear(), m=10.0, c=[1.0, 2.0, 1.5], k=[15.0, 14.0, 16.0]),
    "duffing": build_chain(3, Duffing(), m=10.0, c=1.0, k=15.0, kappa=100.0),
    "van_der_pol": build_chain(3, VanDerPol(), m=10.0, c=1.0, k=15.0, mu=2.0),
    "power_damping": build_chain(3, PowerDamping(3.0), m=10.0, c=1.0, k=15.0, mu=5.0),
}
FORCE = BandedNoise(3, DURATION, 4096, band=[0.1, 0.6], rms=5.0, dofs=[1, 3], seed=2).force


def states(response: Response) -> np.ndarray:
    return np.concatenate([response.displacement, response.velocity], axis=1)


def order(error: Callable[[int], float], steps: list[int]) -> float:
    """Slope of the error over the step in logarithms."""
    return float(np.polyfit(np.log([DURATION / n for n in steps]), np.log([error(n) for n in steps]), 1)[0])


def error_of(structure: Structure, first: float = 0.0, hold: str = "exact", initial=None) -> Callable[[int], float]:
    """By the number of steps of Runge-Kutta, the largest one of the states, against a method of order eight."""

    def motion(steps: int, **options) -> np.ndarray:
        time = np.linspace(first, first + DURATION, steps + 1)
        return states(simulate(structure, FORCE, time, initial=initial, **options))[:: steps // 16]

    solution = motion(16, method="dop853")
    return lambda steps: float(np.max(np.abs(motion(steps, substeps=1, hold=hold) - solution)))


@pytest.mark.parametrize("name", CHAINS)
def test_a_held_force_is_of_first_order_only(name):
    error = error_of(CHAINS[name], hold="zero_order")
    assert order(error, [256, 512, 1024]) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("method", ["rk4", "dop853"])
def test_linear_response_is_the_matrix_exponential(method):
    # The force is a single sinusoid, which two more states generate: then the whole problem is z' = A z.
    structure = CHAINS["linear"]
    omega = 1.3
    generator = np.zeros((8, 8))
    generator[:3, 3:6] = np.eye(3)
    m, c, k = (structure.parameters[kind].numpy() for kind in "mck")
    generator[3:6, :3], generator[3:6, 3:6] = -chain_matrix(k) / m[:, None], -chain_matrix(c) / m[:, None]
    generator[3, 6] = 1.0 / m[0]
    generator[6:, 6:] = [[0.0, omega], [-omega, 0.0]]
    time = np.linspace(0.0, DURATION, 513)
    start = np.array([0.0] * 6 + [0.0, 1.0])
    exact = np.array([expm(generator * t) @ start for t in time[::64]])[:, :6]
    response = simulate(structure, lambda t: np.outer(np.sin(omega * t), [1.0, 0.0, 0.0]), time, method=method)
    np.testing.assert_allclose(states(response)[::64], exact, atol=1e-9 if method == "rk4" else 1e-11)


def test_adaptive_steps_do_not_leap_over_a_late_pulse():
    structure = CHAINS["linear"]
    pulse = Impulse(3, DURATION, 257, peak=10.0, width=0.25, start=6.0, dofs=[2])
    time = np.linspace(0.0, DURATION, 257)
    adaptive = simulate(structure, pulse.force, time, method="dop853")
    assert np.max(np.abs(adaptive.velocity)) > 0.05
    np.testing.assert_allclose(states(adaptive), states(simulate(structure, pulse.force, time, substeps=8)), atol=1e-8)


@pytest.mark.parametrize("hold", ["exact", "zero_order"])
def test_acceleration_obeys_the_equation_of_motion_at_the_samples(hold):
    structure = CHAINS["van_der_pol"]
    time = np.linspace(0.0, DURATION, 257)
    response = simulate(structure, FORCE, time, hold=hold)
    assert response.force == pytest.approx(FORCE(time))
    force = structure.external_force(response.displacement, response.velocity, response.acceleration)
    np.testing.assert_allclose(force, response.force, atol=1e-12)
    assert not states(response)[0].any()


@pytest.mark.parametrize("name", CHAINS)
def test_from_any_start_and_time_runge_kutta_stays_of_fourth_order(name):
    error = error_of(CHAINS[name], first=3.0, initial=np.array([[0.1, -0.2, 0.15], [-0.1, 0.2, 0.3]]))
    assert order(error, [128, 256, 512]) == pytest.approx(4.0, abs=0.2)


@pytest.mark.parametrize("method", ["rk4", "dop853"])
@pytest.mark.parametrize("hold", ["exact", "zero_order"])
def test_a_simulation_goes_on_from_its_middle(method, hold):
    structure, middle = CHAINS["duffing"], 30
    whole = simulate(structure, FORCE, np.linspace(0.0, 0.25 * DURATION, 65), hold, method)
    initial = whole.displacement[middle], whole.velocity[middle]
    rest = simulate(structure, FORCE, whole.time[middle:], hold, method, initial=initial)
    np.testing.assert_allclose(states(rest), states(whole)[middle:], atol=1e-10)
    np.testing.assert_allclose(rest.acceleration, whole.acceleration[middle:], atol=1e-10)
    np.testing.assert_array_equal(rest.time, whole.time[middle:])


@pytest.mark.parametrize("initial", [np.zeros(3), np.zeros((2, 2)), np.full((2, 3), np.nan)])
def test_an_initial_state_that_does_not_fit_is_refused(initial):
    with pytest.raises(ValueError, match=r"initial state must be .* \(2, 3\) finite"):
        simulate(CHAINS["linear"], FORCE, np.linspace(0.0, DURATION, 257), initial=initial)


def test_substeps_follow_the_chain():
    paper = build_chain(6, Duffing(), m=10.0, c=1.0, k=15.0, kappa=100.0)
    assert substeps_needed(paper, 60.0 / 4095) == 1
    assert substeps_needed(paper, 240.0 / 4095) == 1
    stiff = build_chain(3, Linear(), m=5.2, c=20.0, k=44e3)
    # Nobody prescribes a negative one, but an estimate may be one.
    negative = stiff.with_parameters(k=-stiff.parameters["k"], c=-stiff.parameters["c"])
    assert substeps_needed(negative, 1.0) == substeps_needed(stiff, 1.0) > 1
    time = np.linspace(0.0, 1.0, 65)
    default = simulate(stiff, lambda t: np.outer(np.sin(30 * t), [1.0, 0.0, 0.0]), time)
    exact = simulate(stiff, lambda t: np.outer(np.sin(30 * t), [1.0, 0.0, 0.0]), time, method="dop853")
    assert np.max(np.abs(default.velocity - exact.velocity)) < 1e-4 * np.max(np.abs(exact.velocity))


@pytest.mark.parametrize("hold", ["exact", "zero_order"])
def test_an_overflow_says_when_and_why_and_crosses_processes(hold):
    unstable = build_chain(3, Linear(), m=1.0, c=0.0, k=1.0)
    unstable = unstable.with_parameters(k=-1e4 * unstable.parameters["k"])
    with pytest.raises(OverflowsError) as caught:
        simulate(unstable, FORCE, np.linspace(5.0, 9.0, 129), hold)
    assert 6.0 < caught.value.time < 9.0
    assert re.match(r"simulation\.samples=129.*overflows at [\d.]+ s", str(caught.value))
    copy = pickle.loads(pickle.dumps(caught.value))
    assert (str(copy), copy.time) == (str(caught.value), caught.value.time)


@pytest.mark.parametrize(
    ("setting", "changes"),
    [
        ("duration", {"duration": 0.0}),
        ("samples", {"samples": 15}),
        ("hold", {"hold": "first_order"}),
        ("method", {"method": "euler"}),
        ("substeps", {"substeps": 0}),
    ],
)
def test_illegal_settings_are_named(setting, changes):
    told = refusal(Simulation, **{"duration": 60.0, "samples": 4096, **changes})
    assert told.startswith(f"simulation.{setting}=")


@pytest.mark.parametrize("ndof", [1, 6])
def test_the_short_way_to_a_slope_gives_the_same_bits(ndof):
    chain = build_chain(ndof, Duffing(), m=1.3, c=0.7, k=15.0, kappa=100.0)
    equation, rng = StateEquation(chain, chain.parameters_like(np.empty(0)), shaken=False), np.random.default_rng(0)
    state, load = rng.normal(size=(2, ndof)), rng.normal(size=ndof)
    acceleration = chain.acceleration(*state, load, chain.parameters_like(load))
    assert equation.slope is not equation._slope
    np.testing.assert_array_equal(equation.slope(state.ravel(), load), [*state[1], *acceleration])


STEP, STEPS = 0.05, 20 * LEAST_STEPS + 7


def loads(n: int, size: float = 1.0, steps: int = STEPS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of a force on the first DOF that has resonances in its band."""
    time = 0.5 * STEP * np.arange(2 * steps + 1)
    force = np.zeros((len(time), n))
    force[:, 0] = size * sum(np.cos(2.0 * np.pi * f * time + 9.0 * f) for f in np.linspace(0.05, 1.0, 20))
    return force[:-1:2], force[1::2], force[2::2]


def stepped(slope, start, parts) -> np.ndarray:
    states = [start]
    for load in zip(*parts, strict=True):
        states.append(runge_kutta_step(slope, states[-1], *load, STEP))
    return np.array(states)


@pytest.mark.parametrize(
    ("kind", "n", "size"),
    [("duffing", 1, 0.3), ("van_der_pol", 2, 0.3), ("linear", 2, 1.0), ("linear", 30, 1.0), ("duffing", 6, 0.3)],
)
def test_all_states_are_those_of_single_steps(kind, n, size):
    chain, start = small_chain(kind, n), 0.01 * np.ones(2 * n)
    slope = StateEquation(chain, chain.parameters_like(start), False).slope
    expected = stepped(slope, start, loads(n, size))
    found = shot(slope, start, loads(n, size), STEP)
    assert found is not None
    np.testing.assert_array_equal(found[0], start)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def test_pieces_that_cannot_be_joined_are_left_to_single_steps():
    chain = small_chain("duffing", 1)
    slope = StateEquation(chain, chain.parameters_like(np.empty(0)), False).slope
    with np.errstate(over="ignore", invalid="ignore"):
        assert shot(slope, np.zeros(2), loads(1, 1e12), STEP) is None


@pytest.mark.parametrize("hold", ["exact", "zero_order"])
def test_a_long_simulation_is_the_same_both_ways(hold, monkeypatch):
    def force(t: np.ndarray) -> np.ndarray:
        return np.cos(1.3 * t)[:, None] + np.cos(2.1 * t)[:, None]

    chain, time = small_chain("duffing", 1), np.linspace(0.0, 120.0, 2001)
    together = []
    monkeypatch.setattr(one_by_one, "shot", lambda *given: together.append(1) or shot(*given))
    alone = simulate(chain, force, time, hold)
    assert not together
    monkeypatch.setattr(one_by_one, "MANY_STEPS", 1000)
    found = simulate(chain, force, time, hold)
    assert together
    for given, expected in zip((found.displacement, found.velocity), (alone.displacement, alone.velocity), strict=True):
        np.testing.assert_allclose(given, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())
