"""Structures on ground or supports that move, and reduced models, against equations that are written out here."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from beams import beam, deflection
from calls import refusal
from scipy.integrate import solve_ivp

from pinn_cli.record.ensemble import Members, spread_of
from pinn_cli.record.excitation.ground_motion import GroundMotion
from pinn_cli.record.free_run import free_run
from pinn_cli.record.inputs import SupportErrors
from pinn_cli.record.record import Record
from pinn_cli.record.response import QUANTITIES
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation, simulate
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Linear
from pinn_cli.system.finite_elements import build_finite_elements
from pinn_cli.system.quantities import SUPPORT
from pinn_cli.system.structure import Structure
from pinn_cli.system.topology import build_structure

M, C, K, KAPPA = (2000.0, 2000.0, 1500.0), (5e3, 4e3, 3e3), (8e6, 7.2e6, 5.6e6), 1e10
FRAME = build_chain(3, Duffing(), m=list(M), c=list(C), k=list(K), kappa=KAPPA)
# The same masses on soft linear springs, which take few steps, for what is about sensors alone.
SOFT = build_chain(3, Linear(), m=list(M), c=list(C), k=[2e5, 1.8e5, 1.4e5])
DURATION, SAMPLES = 6.0, 601
FORCE = {"band": [0.5, 10.0], "rms": 2e3, "dofs": [2], "seed": 1}
GENERATED = {"rise": 1.0, "strong": 3.0, "decay": 1.0, "highest": 15.0}


def by_hand(motion: GroundMotion, time: np.ndarray) -> tuple[np.ndarray, ...]:
    """Displacement, velocity (relative) and absolute acceleration of the three storeys, (N, 3) each."""

    def absolute(t, x1, x2, x3, v1, v2, v3):
        r1 = C[0] * v1 + K[0] * x1 + KAPPA * x1**3
        r2 = C[1] * (v2 - v1) + K[1] * (x2 - x1) + KAPPA * (x2 - x1) ** 3
        r3 = C[2] * (v3 - v2) + K[2] * (x3 - x2) + KAPPA * (x3 - x2) ** 3
        f = motion.force(np.array([t]))[0, 1]
        return (r2 - r1) / M[0], (f + r3 - r2) / M[1], -r3 / M[2]

    def rate(t, y):
        ground = motion.ground(np.array([t]))[0]
        return [*y[3:], *(a - ground for a in absolute(t, *y))]

    options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-14, "max_step": 0.01}
    y = solve_ivp(rate, (0.0, time[-1]), np.zeros(6), t_eval=time, **options).y
    return y[:3].T, y[3:].T, np.array([absolute(t, *state) for t, state in zip(time, y.T, strict=True)])


@pytest.mark.parametrize("settings", [{"path": "el_centro", "force": FORCE}, GENERATED], ids=["el_centro", "filtered"])
def test_it_moves_as_the_equations_written_out_say(request, settings):
    if "path" in settings:
        folder = request.getfixturevalue("shared") / "data" / "ground_motion"
        settings = {**settings, "path": str(folder / f"{settings['path']}.csv")}
    duration, samples = 1.5, 151
    motion = GroundMotion(3, duration, samples, **settings)
    simulation = Simulation(duration, samples)
    found = simulation.run(FRAME, motion.force, motion.ground)
    u, v, absolute = by_hand(motion, simulation.time)
    for given, expected in ((found.displacement, u), (found.velocity, v), (found.acceleration, absolute)):
        assert np.sqrt(np.mean((given - expected) ** 2)) < 1e-6 * np.sqrt(np.mean(expected**2))
    relative = simulation.run(FRAME, motion.force, motion.ground, "relative").acceleration
    np.testing.assert_allclose(relative, found.acceleration - found.ground_acceleration[:, None], atol=1e-12)
    np.testing.assert_array_equal(found.ground_acceleration, motion.ground(simulation.time))
    np.testing.assert_array_equal(found.force, motion.force(simulation.time))


def simulated(frame: str = "absolute", **noise) -> Simulated:
    motion = GroundMotion(3, DURATION, SAMPLES, force=FORCE, **GENERATED)
    return Simulated(motion, Simulation(DURATION, SAMPLES), Noise(**noise), frame)


def test_a_simulated_record_measures_the_ground_with_noise_of_its_own():
    record, truth = (it := simulated(snr_db=30.0, seed=4).measure(SOFT)).record, it.truth.response
    noise = record.ground_acceleration - truth.ground_acceleration
    ratio = 10.0 * math.log10(np.mean(truth.ground_acceleration**2) / np.mean(noise**2))
    assert ratio == pytest.approx(30.0, abs=0.5)
    assert record.unforced.tolist() == [True, False, True]
    others = [getattr(record, q) - getattr(truth, q) for q in QUANTITIES]
    columns = [x for each in others for x in each.T if x.any()]
    assert max(abs(np.corrcoef(noise, x)[0, 1]) for x in columns) < 0.15


def test_repeats_and_seeds_know_the_ground():
    clean = simulated(snr_db=None).measure(SOFT).truth.response
    true, (_, scatter) = clean.ground_acceleration, Noise(20.0, repeats=4).measured(clean)
    expected = np.std(Noise(20.0).added_to(clean).ground_acceleration - true) / 2.0
    assert scatter.noise_of_mean("ground_acceleration")[0] == pytest.approx(expected, rel=0.1)
    seeds = dict(zip(QUANTITIES, (1, 2, 3, 4), strict=True))
    with pytest.raises(InputError, match="seed for ground_acceleration"):
        Noise(20.0, seeds=seeds).added_to(clean)
    drawn = Noise(20.0, seeds={**seeds, "ground_acceleration": 5}).added_to(clean)
    expected = np.random.RandomState(5).standard_normal(SAMPLES)
    assert np.corrcoef(drawn.ground_acceleration - true, expected)[0, 1] > 0.999


@pytest.mark.parametrize(("frame", "first"), [("absolute", 0), ("relative", 200)])
def test_a_free_run_goes_on_under_the_measured_ground(frame, first):
    it = simulated(frame, snr_db=None).measure(SOFT)
    record, truth = it.record, it.truth.response
    assert record.frame == frame
    found = free_run(SOFT, record, (truth.displacement[first], truth.velocity[first]), first=first)
    for quantity in ("displacement", "acceleration"):
        expected = getattr(truth, quantity)[first:]
        assert np.max(np.abs(getattr(found, quantity) - expected)) < 1e-4 * np.max(np.abs(expected))
    np.testing.assert_allclose(found.ground_acceleration, record.ground_acceleration[first:], atol=1e-9)
    still = free_run(SOFT, replace(record, force=0.0 * record.force, ground_acceleration=0.0 * record.time))
    assert not still.displacement.any()


ELEMENTS, STOP_KAPPA = 3, 4e3
DOFS = {"tip": deflection(3), "middle": deflection(2), "slope": 6}
TIME = np.linspace(0.0, 0.1, 51)
STOP = {"stop": {"between": ["ground", "tip"], "law": "duffing", "c": 0.0, "k": 0.0, "kappa": STOP_KAPPA}}


def push(time):
    """On the middle, N."""
    return 20.0 * np.sin(40.0 * time) * np.sin(7.0 * time + 1.0)


def shaking(time):
    return 30.0 * np.sin(35.0 * time) * np.sin(6.0 * time)


def whole_model(M, K, C, kappa=0.0, push=None, shaking=None):
    """(N, 3) each: displacement, velocity and absolute acceleration of the named DOFs, every DOF integrated."""
    size, places = M.shape[0], [dof - 1 for dof in DOFS.values()]
    moved = np.arange(size) % 2 == 0
    inverse = np.linalg.inv(M)

    def acceleration(t, u, v):
        force = -K @ u - C @ v
        force[places[0]] -= kappa * u[places[0]] ** 3
        force[places[1]] += 0.0 if push is None else push(t)
        return inverse @ force - (0.0 if shaking is None else moved * shaking(t))

    solution = solve_ivp(
        lambda t, y: np.concatenate((y[size:], acceleration(t, y[:size], y[size:]))),
        (TIME[0], TIME[-1]), np.zeros(2 * size), "DOP853", TIME, rtol=1e-11, atol=1e-13, max_step=0.002,
    )  # fmt: skip
    u, v = solution.y[:size].T, solution.y[size:].T
    a = np.array([acceleration(*state) for state in zip(TIME, u, v, strict=True)])
    a = a if shaking is None else a + moved * shaking(TIME)[:, None]
    return u[:, places], v[:, places], a[:, places]


@pytest.fixture
def model(tmp_path):
    M, K = (matrix.toarray() for matrix in beam(ELEMENTS))
    C = 0.8 * M + 2e-4 * K
    C[4, 4] += 0.5  # a dashpot, which couples the modes
    np.savez(tmp_path / "beam.npz", M=M, K=K, C=C)
    return M, K, C, str(tmp_path / "beam.npz")


@pytest.mark.parametrize("kappa", [0.0, STOP_KAPPA], ids=["linear", "cubic"])
def test_a_pushed_model_moves_as_its_matrices_say(model, kappa):
    *matrices, path = model
    structure = build_finite_elements(DOFS, path, modes=6, connections=STOP if kappa else None)
    force = lambda time: np.outer(push(time), [0.0, 1.0, 0.0])  # noqa: E731
    response = simulate(structure, force, TIME, method="dop853")
    for found, expected in zip(
        (response.displacement, response.velocity, response.acceleration),
        whole_model(*matrices, kappa=kappa, push=push), strict=True,
    ):  # fmt: skip
        assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()
    np.testing.assert_array_equal(response.force, force(TIME))
    assert response.coordinates.shape == (len(TIME), 2, 6)


def test_a_shaken_model_moves_as_its_matrices_say(model):
    *matrices, path = model
    structure = build_finite_elements(DOFS, path, modes=6, ground="1::2")
    nothing = lambda time: np.zeros((len(time), 3))  # noqa: E731
    absolute = simulate(structure, nothing, TIME, method="dop853", ground=shaking)
    relative = simulate(structure, nothing, TIME, method="dop853", ground=shaking, frame="relative")
    u, v, a = whole_model(*matrices, shaking=shaking)
    for found, expected in zip(
        (absolute.displacement, absolute.velocity, absolute.acceleration, relative.acceleration),
        (u, v, a, a - np.outer(shaking(TIME), [1.0, 1.0, 0.0])), strict=True,
    ):  # fmt: skip
        assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


def test_a_simulation_goes_on_from_its_coordinates(model):
    structure = build_finite_elements(DOFS, model[3], modes=4, connections=STOP)
    force = lambda time: np.outer(push(time), [0.0, 1.0, 0.0])  # noqa: E731
    response = simulate(structure, force, TIME, substeps=40)
    later = simulate(structure, force, TIME[30:], substeps=40, initial=response.state(30))
    np.testing.assert_allclose(later.displacement, response.displacement[30:], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(
    ("how", "setting"), [({"ground": shaking}, "system.ground"), ({"hold": "zero_order"}, "simulation.hold")]
)
def test_what_a_reduced_model_cannot_do_is_refused(model, how, setting):
    structure = build_finite_elements(DOFS, model[3], modes=4)
    assert refusal(simulate, structure, lambda time: np.zeros((len(time), 3)), TIME, **how).startswith(f"{setting}=")
    held = Simulated(GroundMotion(3, DURATION, SAMPLES), Simulation(DURATION, SAMPLES, hold="zero_order"), Noise())
    assert "simulation.hold=zero_order: must be exact where the ground moves" in refusal(held.measure, FRAME)


TABLE_M, TABLE_C, TABLE_K, TABLE_KAPPA, F_C = (400.0, 300.0), (200.0, 150.0, 90.0), (9e4, 6e4, 2e4), 4e8, 60.0
OMEGA, SIZE = np.array([[5.0, 23.0], [9.0, 31.0]]), np.array([[6e-3, 2e-3], [4e-3, 1e-3]])
STEP = 0.01


def frame(friction: bool = False) -> Structure:
    """Two masses: one on a table, by a spring that stiffens or a contact, the other on a wall and on the ground."""
    law = {"law": "friction", "speed": 0.02, "F_c": F_C} if friction else {"law": "duffing", "kappa": TABLE_KAPPA}
    connections = {
        "tie": {"between": ["table", "x1"], "c": TABLE_C[0], "k": TABLE_K[0], **law},
        "spring": {"between": ["x1", "x2"], "law": "linear", "c": TABLE_C[1], "k": TABLE_K[1]},
        "stay": {"weights": {"x2": 0.8, "wall": -0.6}, "law": "linear", "c": TABLE_C[2], "k": TABLE_K[2]},
        "post": {"between": ["ground", "x2"], "law": "linear", "c": 10.0, "k": 1e4},
    }
    return build_structure(["x1", "x2"], {"x1": TABLE_M[0], "x2": TABLE_M[1]}, connections, supports=["table", "wall"])


def moved(time: np.ndarray, order: int) -> np.ndarray:
    """(N, 2), displacement of the supports or a derivative of it."""
    phase = OMEGA * time[:, None, None] + np.array([0.0, 0.5 * np.pi])
    return (SIZE * OMEGA**order * np.sin(phase + 0.5 * np.pi * order)).sum(-1)


def carried_by_hand(time: np.ndarray, friction: bool) -> tuple[np.ndarray, ...]:
    """Displacement, velocity and acceleration of the two masses from rest, (N, 2) each."""

    def acceleration(t, x1, x2, v1, v2):
        (s1, s2), (d1, d2) = (moved(np.array([t]), order)[0] for order in (0, 1))
        e, de = x1 - s1, v1 - d1
        r1 = TABLE_C[0] * de + TABLE_K[0] * e + (F_C * np.tanh(de / 0.02) if friction else TABLE_KAPPA * e**3)
        r2 = TABLE_C[1] * (v2 - v1) + TABLE_K[1] * (x2 - x1)
        r3 = TABLE_C[2] * (0.8 * v2 - 0.6 * d2) + TABLE_K[2] * (0.8 * x2 - 0.6 * s2)
        return (r2 - r1) / TABLE_M[0], (-r2 - 0.8 * r3 - 10.0 * v2 - 1e4 * x2) / TABLE_M[1]

    options = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-13, "max_step": STEP}
    rate = lambda t, y: [*y[2:], *acceleration(t, *y)]  # noqa: E731
    y = solve_ivp(rate, (0.0, time[-1]), np.zeros(4), t_eval=time, **options).y
    return y[:2].T, y[2:].T, np.array([acceleration(t, *state) for t, state in zip(time, y.T, strict=True)])


def record_of(order: int, duration: float = 2.0) -> Record:
    time = np.arange(round(duration / STEP)) * STEP
    still, blank = np.zeros((len(time), 2)), np.full((len(time), 2), np.nan)
    begins = np.array([moved(np.zeros(1), k)[0] for k in (0, 1)])
    measured = {list(SUPPORT)[order]: moved(time, order)}
    unforced, names = np.ones(2, bool), ("table", "wall")
    return Record(
        time, still, blank, blank, still, unforced, supports=measured, support_names=names, supports_begin=begins
    )


@pytest.mark.parametrize(("order", "friction"), [(0, False), (1, False), (2, False), (0, True)])
def test_on_supports_it_moves_as_the_equations_written_out_say(order, friction):
    record = record_of(order)
    found = free_run(frame(friction), record, None)
    inside = slice(None) if friction else slice(20, -20)  # what ends a record is interpolated less well
    expected = carried_by_hand(record.time, friction)
    for given, true in zip((found.displacement, found.velocity, found.acceleration), expected, strict=True):
        assert np.sqrt(np.mean((given - true)[inside] ** 2)) < (5e-4 if friction else 1e-4) * np.sqrt(np.mean(true**2))
    for k in range(3):
        off = found.supports[inside, k] - moved(record.time, k)[inside]
        assert np.sqrt(np.mean(off**2)) < 1e-4 * 10.0**k * np.sqrt(np.mean(moved(record.time, k) ** 2)), k


def test_errors_of_a_displacement_and_of_an_acceleration():
    """A sensor's noise is a displacement's error as it is, and an acceleration's integrated twice: a random walk's."""
    for order in (0, 2):
        record = record_of(order, duration=10.0)
        sigma = np.array([2e-4, 0.0]) if order == 0 else np.array([0.05, 0.0])
        errors = SupportErrors.of(record, {list(SUPPORT)[order]: sigma})
        assert errors is not None
        drawn = errors.drawn(np.random.default_rng(0), len(record.time) - 1, np.zeros((400, 3, 2)))
        late = drawn[-1].std(axis=0)
        time = record.time[-1]
        walk = [0.05 * STEP**0.5 * time**1.5 / 3**0.5, 0.05 * (STEP * time) ** 0.5, 0.05]
        expected = [2e-4, 0.0, 0.0] if order == 0 else walk
        np.testing.assert_allclose(late[:, 0], expected, rtol=0.15)
        assert not late[:, 1].any()


def test_members_share_the_supports_and_not_their_errors():
    structure, record = frame().with_parameters(kappa=torch.zeros(1, dtype=torch.float64)), record_of(0, 3.0)
    parameters = {kind: np.tile(x, (200, 1)) for kind, x in structure.parameters_like(np.empty(0)).items()}
    about = free_run(structure, record, None)
    none = np.zeros((0, 2))
    still = spread_of(Members(parameters, np.zeros((200, 4)), none, 0), structure, record, about)
    assert still.displacement.max() < 1e-5 * np.abs(about.displacement).max()
    errors = SupportErrors.of(record, {"support_displacement": np.array([1e-4, 0.0])})
    spread = spread_of(Members(parameters, np.zeros((200, 4)), none, 0, carried=errors), structure, record, about)
    # Noise of a table as white noise of the spring's force (its damper matters little here).
    pushed = Members(parameters, np.zeros((200, 4)), np.array([[TABLE_K[0] * 1e-4, 0.0]]), 1)
    expected = spread_of(pushed, structure, record, about)
    late = record.time > 1.5
    ratio = spread.displacement[late].mean(0) / expected.displacement[late].mean(0)
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)
