"""Laws that turn round with the motion, and those too stiff for explicit steps, against equations written out here."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pinn_cli.record.between_samples import BandLimited
from pinn_cli.record.ensemble import Members, spread_of
from pinn_cli.record.free_run import free_run
from pinn_cli.record.record import Record
from pinn_cli.record.simulation import Simulation, simulate
from pinn_cli.record.steps import LOAD_BLOCK, PiecewiseLoad, substeps_needed
from pinn_cli.system.connection import Jenkins
from pinn_cli.system.structure import Structure
from pinn_cli.system.topology import build_structure

GROUND_TO_X = ["ground", "x"]


def sines(t, frequencies, amplitude, seed=0):
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(frequencies))
    return amplitude * np.sin(2.0 * np.pi * np.multiply.outer(t, frequencies) + phase).sum(-1)


def reference(motion, start, time, longest):
    options = {"rtol": 1e-11, "atol": 1e-15, "max_step": longest}
    return solve_ivp(motion, (time[0], time[-1]), start, "DOP853", time, **options).y.T


def relative(found, expected):
    return np.sqrt(np.mean((found - expected) ** 2, axis=0) / np.mean(expected**2, axis=0)).max()


def oscillator(**law):
    return build_structure(["x"], {"x": 2.0}, {"joint": {"between": GROUND_TO_X, "c": 10.0, "k": 5e4, **law}})


@pytest.mark.parametrize(("beta", "gamma", "n"), [(800.0, -1100.0, 1), (8.0, 3.0, 2)], ids=["sharp", "n=2"])
def test_bouc_wen_is_followed_across_its_corners(beta, gamma, n):
    frequencies, time = np.linspace(5.0, 150.0, 30), np.arange(80) / 750.0
    structure = oscillator(law="bouc_wen", A=5e4, beta=beta, gamma=gamma, n=n)

    def motion(t, y):
        u, v, z = y
        rate = 5e4 * v - beta * abs(v) * abs(z) ** (n - 1) * z - gamma * v * abs(z) ** n
        return [v, (sines(t, frequencies, 13.0) - 10.0 * v - 5e4 * u - z) / 2.0, rate]

    expected = reference(motion, np.zeros(3), time, 1e-3)
    found = Simulation(time[-1], len(time)).run(structure, lambda t: sines(t, frequencies, 13.0)[:, None])
    states = np.column_stack((found.displacement, found.velocity, found.hidden))
    assert relative(states, expected) < 1e-6


def degrading(pinching, x, energy, z, v):
    """dz/dt of Baber and Noori (1986), written out here: (A, beta, gamma, n), (delta_nu, delta_eta), pinching."""
    (a, beta, gamma, n), (delta_nu, delta_eta) = x
    nu, eta, h = 1.0 + delta_nu * energy, 1.0 + delta_eta * energy, 1.0
    if pinching is not None:
        zeta_s, q, p, psi, delta_psi, rest = pinching
        depth = zeta_s * (1.0 - math.exp(-p * energy))
        ultimate = (a / (nu * (beta + gamma))) ** (1.0 / n)
        width = (psi + delta_psi * energy) * (rest + depth)
        h -= depth * math.exp(-(((z * np.sign(v) / ultimate - q) / width) ** 2))
    return h * (a * v - nu * (beta * abs(v) * abs(z) ** (n - 1) * z + gamma * v * abs(z) ** n)) / eta


@pytest.mark.parametrize("pinching", [None, (0.8, 0.1, 4.0, 0.3, 0.5, 0.4)], ids=["degrades", "pinches"])
def test_a_joint_loses_what_its_energy_costs_it(pinching):
    """The second state is that energy, counted over any elongation, and moves nothing."""
    frequencies, time, own = np.linspace(5.0, 60.0, 30), np.arange(300) / 400.0, ((5e4, 400.0, 200.0, 1), (1.5, 2.5))
    law = dict(zip(("A", "beta", "gamma", "n", "delta_nu", "delta_eta"), sum(own, ()), strict=True))
    names = ("zeta_s", "q", "p", "psi", "delta_psi", "lambda")
    law |= {} if pinching is None else dict(zip(names, pinching, strict=True))
    structure = oscillator(law="baber_noori", **law)

    def motion(t, y):
        u, v, z, energy = y
        pulled = (sines(t, frequencies, 40.0) - 10.0 * v - 5e4 * u - z) / 2.0
        return [v, pulled, degrading(pinching, own, energy, z, v), z * v]

    expected = reference(motion, np.zeros(4), time, 1e-3)
    assert 1.5 * expected[-1, 3] > 0.5  # of its strength a third is gone
    for size in (1.0, 0.02):
        counted = structure.moving_by(size)
        found = Simulation(time[-1], len(time)).run(counted, lambda t: sines(t, frequencies, 40.0)[:, None])
        states = np.column_stack((found.displacement, found.velocity, found.hidden[:, 0], size * found.hidden[:, 1]))
        assert relative(states, expected) < 1e-5


def test_two_hysteretic_storeys_on_moving_ground():
    frequencies, time = np.linspace(0.5, 9.0, 12), np.arange(81) / 50.0
    law = {"law": "bouc_wen", "A": 3e5, "gamma": 20.0, "n": 1}
    structure = build_structure(
        ["x1", "x2"],
        {"x1": 1500.0, "x2": 1000.0},
        {
            "lower": {"between": ["ground", "x1"], "c": 2e3, "k": 4e5, "beta": 60.0, **law},
            "upper": {"between": ["x1", "x2"], "c": 1e3, "k": 3e5, "beta": 90.0, **law},
        },
    )

    def motion(t, y):
        x1, x2, v1, v2, z1, z2 = y
        lower, upper = 2e3 * v1 + 4e5 * x1 + z1, 1e3 * (v2 - v1) + 3e5 * (x2 - x1) + z2
        shaken = sines(t, frequencies, 0.6)
        h1 = 3e5 * v1 - 60.0 * abs(v1) * z1 - 20.0 * v1 * abs(z1)
        h2 = 3e5 * (v2 - v1) - 90.0 * abs(v2 - v1) * z2 - 20.0 * (v2 - v1) * abs(z2)
        return [v1, v2, (upper - lower) / 1500.0 - shaken, -upper / 1000.0 - shaken, h1, h2]

    expected = reference(motion, np.zeros(6), time, 1e-2)
    still, shaking = lambda t: np.zeros((len(t), 2)), lambda t: sines(t, frequencies, 0.6)
    found = Simulation(time[-1], len(time)).run(structure, still, shaking)
    assert relative(np.column_stack((found.displacement, found.velocity, found.hidden)), expected) < 1e-6
    assert np.abs(found.hidden).max() > 0.5 * 3e5 / 110.0  # the joints yield


@pytest.mark.parametrize("below", [0.0, 1e-16, 1e-13, 1e-6])
def test_a_step_that_begins_just_inside_a_corner(below):
    """It was divided into 1e-14 of it and the rest, which begins just inside the corner too, for ever."""
    speed, time = 1e-3, np.arange(20) / 200.0
    start = 6.0 * speed * (1.0 - below)  # from there on the law is straight

    def motion(t, y):
        return [y[1], (0.6 + 3e4 * t - 10.0 * y[1] - 5e4 * y[0] - 0.5 * math.tanh(y[1] / speed)) / 2.0]

    expected = reference(motion, [0.0, start], time, 1e-4)
    push = lambda t: 0.6 + 3e4 * t[:, None]  # noqa: E731
    found = simulate(oscillator(law="friction", speed=speed, F_c=0.5), push, time, initial=([0.0], [start]))
    assert relative(np.column_stack((found.displacement, found.velocity)), expected) < 1e-6


def test_a_held_force_is_held_in_the_parts_of_a_step_too():
    time = np.arange(50) / 200.0
    structure = oscillator(law="bouc_wen", A=5e4, beta=800.0, gamma=-100.0, n=1)
    force = lambda t: sines(t, np.array([7.0, 19.0]), 60.0)[:, None]  # noqa: E731
    coarse, fine = (simulate(structure, force, time, "zero_order", substeps=s).displacement for s in (10, 40))
    assert relative(coarse, fine) < 5e-6


def test_steps_are_short_enough_for_friction_at_rest():
    """F_c / speed damps the mass, at rest twice as fast as Gershgorin's bound has it, which no spring does."""
    sliding = oscillator(law="friction", speed=0.02, F_c=4e6)
    assert substeps_needed(sliding, 1e-3) == pytest.approx(1e-3 * 2.0 * (10.0 + 4e6 / 0.02) / 2.0 / 0.2, rel=0.01)
    assert substeps_needed(oscillator(law="friction", speed=0.02, F_c=0.1), 1e-3) < 10


M, K, F_C = 2.0, 800.0, 3.0
OMEGA, TIMES = np.sqrt(K / M), np.arange(301) / 200.0
BEFORE, ENDS, SWINGS = 5.4, 0.6, 3  # in F_c / k: the swings end at -3.4, 1.4 and 0.6, and there it sticks


def rubbing(**law: object) -> Structure:
    joint = {"between": GROUND_TO_X, "c": 0, "k": K, "F_c": F_C, **law}
    return build_structure(["x"], {"x": M}, {"joint": joint})


def left_alone() -> Record:
    nothing = np.zeros((len(TIMES), 1))
    unknown = np.full_like(nothing, np.nan)
    return Record(TIMES, nothing, unknown, unknown, nothing, np.array([True]))


def coulomb(time: np.ndarray) -> np.ndarray:
    """Displacement: half a cosine about F_c / k against the motion for each swing, until the spring holds no more."""
    swing = (OMEGA * time // np.pi).astype(int)
    amplitude, side = BEFORE - 1.0 - 2.0 * swing, np.where(swing % 2, -1.0, 1.0)
    moving = side * (amplitude * np.cos(OMEGA * time - np.pi * swing) + 1.0)
    return F_C / K * np.where(swing < SWINGS, moving, ENDS)


@pytest.mark.parametrize("law", [{"law": "friction"}, {"law": "friction", "speed": 1e-5}], ids=["sticks", "creeps"])
def test_a_free_decay_under_friction_ends_where_it_sticks(law):
    found = free_run(rubbing(**law), left_alone(), ([BEFORE * F_C / K], [0.0]))
    expected = coulomb(TIMES)
    assert np.abs(found.displacement[:, 0] - expected).max() < 2e-3 * expected.max()
    assert np.abs(found.acceleration[-20:]).max() < 1e-3 * F_C / M
    # A stiff contact ends within a few of its own yields of there.
    contact = free_run(rubbing(law="jenkins", k_t=3e5, sharpness=20.0), left_alone(), ([BEFORE * F_C / K], [0.0]))
    assert np.abs(contact.displacement[-1, 0] - expected[-1]) < 8.0 * F_C / 3e5
    assert np.abs(contact.hidden).max() < 1.01 * F_C


def test_a_held_force_above_friction_moves_and_one_below_does_not():
    push = np.where(np.arange(120) < 60, 0.9, 1.2)[:, None] * F_C
    found = Simulation(119 / 200.0, 120, hold="zero_order").run(rubbing(law="friction", k=0), lambda _: push)
    since = (np.arange(120) - 60) / 200.0
    np.testing.assert_allclose(found.displacement[:61], 0.0, atol=1e-6)
    np.testing.assert_allclose(found.displacement[60:, 0], 0.2 * F_C / M * since[60:] ** 2 / 2.0, atol=1e-6)


def test_members_that_differ_in_nothing_do_what_one_alone_does():
    structure, start = rubbing(law="friction"), [BEFORE * F_C / K, 0.0]
    one = free_run(structure, left_alone(), (start[:1], start[1:]))
    own = {kind: np.tile(value.numpy(), (3, 1)) for kind, value in structure.parameters.items()}
    own["F_c"] *= np.array([[1.0], [1.0], [1.1]])
    members = Members(own, np.tile(start, (3, 1)), np.zeros((0, 1)), 0)
    two = Members({kind: value[:2] for kind, value in own.items()}, members.start[:2], members.sources, 0)
    assert np.abs(spread_of(two, structure, left_alone(), one).displacement).max() < 1e-5 * F_C / K
    spread = spread_of(members, structure, left_alone(), one).displacement
    assert np.abs(spread).max() > 0.05 * F_C / K


def test_a_contact_dissipates_what_its_slider_does():
    """Over a cycle of amplitude a, 4 F_c (a - F_c / k_t); and less than F_c it holds without any loss."""
    law, parameters = Jenkins(sharpness=60.0), {"k_t": np.array(1e4), "F_c": np.array(F_C)}
    for amplitude, lost in ((5.0 * F_C / 1e4, 4.0 * F_C * 4.0 * F_C / 1e4), (0.9 * F_C / 1e4, 0.0)):
        phase = np.linspace(0.0, 6.0 * np.pi, 6_001)
        e, z = amplitude * np.sin(phase), np.zeros(len(phase))
        for i, de in enumerate(np.diff(e)):
            z[i + 1] = z[i] + law.rate(e[i], np.array(de), [z[i : i + 1]], parameters)[0][0]
        last = phase >= 4.0 * np.pi
        assert np.trapezoid(z[last], e[last]) == pytest.approx(lost, abs=2e-2 * 4.0 * F_C * amplitude)


def test_a_load_from_piece_to_piece_is_that_of_its_samples():
    """From block to block, beyond the last sample too, where an integrator looks."""
    rng = np.random.default_rng(3)
    time = 5.0 + np.arange(LOAD_BLOCK + 50) / 80.0
    history = BandLimited(time, rng.standard_normal((len(time), 2)))
    load = PiecewiseLoad(history, time)
    for at in (*rng.uniform(time[0], time[-1], 200), time[0], time[LOAD_BLOCK], time[-1], time[-1] + 0.01):
        np.testing.assert_allclose(load(at), history(np.array([at]))[0], atol=1e-9)
    sine, omega = PiecewiseLoad(lambda t: np.sin(0.9 * np.pi * 80.0 * t), time), 0.9 * np.pi * 80.0
    missed = [abs(float(sine(at)) - np.sin(omega * at)) for at in rng.uniform(time[0], time[-1], 200)]
    assert max(missed) < 1e-7


@pytest.mark.parametrize("rounding", [0.0, 1e-14, 1e-12])
def test_sticking_takes_few_steps_however_fast_the_motion(monkeypatch, rounding):
    """A contact that turned within the error of a velocity took hundreds of slopes a sample, or never ended."""
    monkeypatch.setattr("pinn_cli.record.steps.MOST_SLOPES", 60)
    connections = {
        "foot": {"between": GROUND_TO_X, "law": "linear", "c": 40.0, "k": 2e4},
        "joint": {"between": ["x", "y"], "law": "friction", "c": 30.0, "k": 1e4, "F_c": 250.0},
    }
    structure = build_structure(["x", "y"], {"x": 320.0, "y": 260.0}, connections)
    time, frequencies = np.arange(800) / 20.0, np.linspace(0.2, 3.0, 9)

    def force(t):
        acting = sines(t, frequencies, 2500.0)
        return np.stack((np.zeros_like(t), acting * (1.0 + rounding * np.sin(1e7 * t))), axis=-1)

    found = simulate(structure, force, time)
    assert np.ptp(found.velocity[:, 1]) > 1.0
    elongation = found.velocity[:, 1] - found.velocity[:, 0]
    assert (np.abs(elongation) < 1e-3 * np.abs(elongation).max()).sum() < 400
