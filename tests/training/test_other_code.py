"""Whole estimates of structures whose records other code has made."""

from functools import cache

import numpy as np
import pytest
from lacking_records import RATE as QUIET_RATE
from lacking_records import C as QUIET_C
from lacking_records import K as QUIET_K
from lacking_records import M as QUIET_M
from lacking_records import posed
from one_record import by_spline
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete, lsim
from storeys import chain_matrix, under_waves

from pinn_cli.record.record import Record
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Linear
from pinn_cli.system.topology import build_structure
from pinn_cli.training.estimate import Estimate
from pinn_cli.verdict.judge import judge

M, C, K, KAPPA = np.array([1000.0, 800.0]), np.array([900.0, 700.0]), np.array([3e5, 2.5e5]), 1.5e9
RATE, FINER, SAMPLES = 50.0, 8, 1500
# Part of the Nyquist frequency up to which the force is white, and the rms elongation that it makes, m.
BAND, STRETCH = 0.8, 0.01


def pushed(seed: int) -> tuple[Record, np.ndarray]:
    """Accelerations at 30 dB under a white force on the second mass, by Runge-Kutta's method; and that force (N,)."""
    rng, step = np.random.default_rng(seed), 1.0 / RATE / FINER
    spectrum = np.fft.rfft(rng.normal(size=SAMPLES * FINER))
    spectrum[np.fft.rfftfreq(SAMPLES * FINER, step) > BAND * 0.5 * RATE] = 0.0
    force = np.fft.irfft(spectrum, SAMPLES * FINER)
    force *= 900.0 / force.std()

    def rate(state: np.ndarray, load: float) -> np.ndarray:
        e, de = np.diff(state[:2], prepend=0.0), np.diff(state[2:], prepend=0.0)
        held = C * de + K * e + np.array([KAPPA, 0.0]) * e**3
        return np.concatenate([state[2:], (np.array([held[1], load]) - held) / M])

    state, found = np.zeros(4), []
    for one, two in zip(force, np.append(force[1:], 0.0), strict=True):
        a = rate(state, one)
        found.append([*state, *a[2:]])
        b = rate(state + step / 2 * a, 0.5 * (one + two))
        c = rate(state + step / 2 * b, 0.5 * (one + two))
        state = state + step / 6 * (a + 2 * b + 2 * c + rate(state + step * c, two))
    motion = np.array(found)[::FINER]
    acceleration = motion[:, 4:]
    noisy = acceleration + 10**-1.5 * acceleration.std(0) * rng.normal(size=acceleration.shape)
    nothing = np.full_like(noisy, np.nan)
    unknown = np.column_stack([np.zeros(SAMPLES), np.full(SAMPLES, np.nan)])
    record = Record(np.arange(SAMPLES) / RATE, nothing, nothing, noisy, unknown, np.array([True, False]))
    return record, force[::FINER]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_all_parameters_are_told_beside_a_force_that_nobody_measured(seed):
    record, force = pushed(seed)
    structure = build_chain(2, Duffing(), m=M, c=2.0 * C, k=0.7 * K, kappa=np.array([0.5 * KAPPA, 0.0]))
    unknown = ["c_*", "k_*", "kappa_1"]
    problem = StateParameter(unobserved=[], unknown=unknown, parameter_uncertainty=0.0).pose(structure, [record]).alone
    estimate = by_spline(problem)
    truth = {"c_1": C[0], "c_2": C[1], "k_1": K[0], "k_2": K[1], "kappa_1": KAPPA}
    for p in estimate.parameters:
        assert abs(p.estimate - truth[p.name]) < 4.0 * p.std
        assert abs(p.estimate / truth[p.name] - 1.0) < (0.02 if p.name.startswith("k_") else 0.15)
    inside = slice(50, -50)
    left = np.mean((estimate.response.force[inside, 1] - force[inside]) ** 2) / np.mean(force[inside] ** 2)
    assert left < 0.08
    assert judge(problem, estimate).word == "sound"


JOINT_M, JOINT_C, JOINT_RATE, JOINT_SAMPLES = 1500.0, 900.0, 50.0, 1500
TRUE = {"k": 2e5, "A": 3e5, "beta": 90.0, "gamma": 40.0, "delta_nu": 8e-4, "delta_eta": 5e-4}
UNKNOWN = [f"{kind}_joint" for kind in TRUE]


def rocked(seed: int) -> Record:
    """Acceleration and force of one mass at 40 dB."""
    rng, time = np.random.default_rng(seed), np.arange(JOINT_SAMPLES) / JOINT_RATE
    lines = rng.uniform(0.3, 8.0, 120)
    phase = rng.uniform(0.0, 2.0 * np.pi, len(lines))

    def force(t):
        return 350.0 * np.sin(2.0 * np.pi * np.multiply.outer(t, lines) + phase).sum(-1)

    def motion(t, y):
        u, v, z, energy = y
        nu, eta = 1.0 + TRUE["delta_nu"] * energy, 1.0 + TRUE["delta_eta"] * energy
        rate = (TRUE["A"] * v - nu * (TRUE["beta"] * abs(v) * z + TRUE["gamma"] * v * abs(z))) / eta
        return [v, (force(t) - JOINT_C * v - TRUE["k"] * u - z) / JOINT_M, rate, z * v]

    states = solve_ivp(motion, (0.0, time[-1]), np.zeros(4), "DOP853", time, rtol=1e-9, atol=1e-12, max_step=0.01).y.T
    assert states[-1, 3] * TRUE["delta_nu"] > 0.3
    acceleration = np.array([motion(*at)[1] for at in zip(time, states, strict=True)])
    noisy = [x + 1e-2 * x.std() * rng.normal(size=JOINT_SAMPLES) for x in (acceleration, force(time))]
    nothing = np.full((JOINT_SAMPLES, 1), np.nan)
    return Record(time, nothing, nothing, noisy[0][:, None], noisy[1][:, None], np.array([False]))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_its_law_is_identified(seed):
    law = {"law": "baber_noori", "c": JOINT_C, "k": None, "n": 1.0} | dict.fromkeys(list(TRUE)[1:])
    structure = build_structure(["x"], {"x": JOINT_M}, {"joint": {"between": ["ground", "x"], **law}})
    record = rocked(seed)
    scheme = StateParameter(unobserved=[], unknown=UNKNOWN, parameter_uncertainty=0.0, initial_motion="rest")
    problem = scheme.pose(scheme.adapted(structure, [record]), [record])
    estimate = by_spline(problem)
    for p in estimate.parameters:
        true = TRUE[p.name.removesuffix("_joint")]
        assert abs(p.estimate - true) < 4.0 * p.std
        assert p.estimate == pytest.approx(true, rel=0.1)
    assert judge(problem.alone, estimate).word == "sound"


@pytest.mark.slow
def test_a_mode_that_has_soon_died_out_after_a_release_is_followed():
    """Two masses let go by a rope; of the roof alone, the second mode is gone after a tenth of the record."""
    m, c, k, rate, duration = np.array([31.7, 29.0]), np.array([104.0, 72.5]), np.array([3.35e5, 2.34e5]), 260.0, 4.28
    damping_and_stiffness = chain_matrix(c), chain_matrix(k)
    start = np.concatenate((np.linalg.solve(damping_and_stiffness[1], [0.0, 9.0]), np.zeros(2)))
    time, nothing = np.arange(round(duration * rate)) / rate, np.zeros(0)
    *_, acceleration, _ = under_waves(m, damping_and_stiffness, np.zeros(2), (nothing, nothing), time, rate, start)
    shown = np.full_like(acceleration, np.nan)
    noise = 0.01 * np.abs(acceleration[:, 1]).max()
    shown[:, 1] = acceleration[:, 1] + noise * np.random.default_rng(0).standard_normal(len(time))
    nowhere = np.full_like(shown, np.nan)
    record = Record(time, nowhere, nowhere, shown, np.zeros_like(shown), np.ones(2, dtype=bool))
    structure = build_chain(2, Linear(), m=m, c=1.5 * c, k=k / 1.5)
    problem = StateParameter(unobserved=[], unknown=["k_*", "c_*"]).pose(structure, [record]).alone
    estimate = by_spline(problem)
    # Its two frequencies are those of another structure, too: one of both is reported.
    (rival,) = estimate.rivals
    true = dict(zip((p.name for p in estimate.parameters), (*c, *k), strict=True))
    both = [{p.name: p.estimate for p in estimate.parameters}, rival.values]
    nearest = min(both, key=lambda values: abs(values["k_1"] / true["k_1"] - 1.0))
    for p in estimate.parameters:
        assert nearest[p.name] == pytest.approx(true[p.name], rel=0.005 if p.kind == "k" else 0.1)
        assert p.std < 0.1 * p.estimate
    assert [finding.kind for finding in judge(problem, estimate).reasons] == ["rival"]


QUIET_SAMPLES, QUIET_FINER, LEVEL = 1000, 8, 0.01


@cache
def estimated(heavier: float) -> Estimate:
    """Of three storeys, of which the lowest is so much heavier than its model says, under a force up to Nyquist."""
    rng = np.random.default_rng(5)
    lines = rng.standard_normal((2, QUIET_SAMPLES // 2 + 1)).T @ [1.0, 1.0j]
    padded = np.zeros(QUIET_SAMPLES * QUIET_FINER // 2 + 1, complex)
    padded[2 : QUIET_SAMPLES // 2 - 10] = lines[2 : QUIET_SAMPLES // 2 - 10]
    force = np.fft.irfft(padded)
    time = np.arange(len(force)) / (QUIET_RATE * QUIET_FINER)
    force *= 5e3 / force.std() * np.minimum(1.0, time)
    rows, mass = np.eye(3) - np.eye(3, k=-1), QUIET_M * [heavier, 1.0, 1.0]
    k, c = (rows.T @ np.diag(x) @ rows for x in (QUIET_K, QUIET_C))
    a = np.block([[np.zeros((3, 3)), np.eye(3)], [-k / mass[:, None], -c / mass[:, None]]])
    b = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0 / mass[2]])[:, None]
    state = lsim((a, b, np.eye(6), np.zeros((6, 1))), force, time)[1]
    shown = (state @ a.T + force[:, None] * b.T)[::QUIET_FINER, 3:]
    cell = np.zeros_like(shown)
    cell[:, 2] = force[::QUIET_FINER]
    noisy = [x + LEVEL * x.std(axis=0) * rng.standard_normal(x.shape) for x in (shown, cell)]
    absent = np.full_like(shown, np.nan)
    record = Record(time[::QUIET_FINER], absent, absent, *noisy, unforced=np.array([True, True, False]))
    return by_spline(posed(record))


@pytest.mark.slow
def test_what_the_model_lacks_is_no_noise_of_the_cell():
    estimate = estimated(1.15)
    assert estimate.noise.sensors["force"][2] < 2.0 * LEVEL * 5e3
    assert estimate.stories[0].name == "free run"
    assert (estimate.doubts[0].kind, estimate.doubts[0].of) == ("m", "DOF 1")


def test_noise_that_is_white_stays_noise():
    estimate = estimated(1.0)
    assert estimate.noise.sensors["force"][2] == pytest.approx(LEVEL * 5e3, rel=0.5)
    assert not estimate.stories
    assert not estimate.doubts


STOREY, STOREYS, RATIO = 1000.0, np.array([3.0e6, 1.0e6]), 1e-3
OTHER = np.array([2.0 * STOREYS[1], STOREYS[0] / 2.0])


def shaken(seed: int) -> Record:
    """10 s at 100 Hz, the ground's acceleration held between 2000 samples a second and known, the roof's at 40 dB."""
    rng, fine, rate = np.random.default_rng(seed), 2000.0, 100.0
    time = np.arange(round(10.0 * fine)) / fine
    lines = np.arange(0.5, 20.0, 0.1)
    ground = np.cos(2.0 * np.pi * np.outer(time, lines) + rng.uniform(0.0, 2.0 * np.pi, len(lines))).sum(axis=1)
    stiffness = np.array([[STOREYS.sum(), -STOREYS[1]], [-STOREYS[1], STOREYS[1]]]) / STOREY
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -RATIO * stiffness]])
    b = np.array([[0.0], [0.0], [-1.0], [-1.0]])
    step, load, *_ = cont2discrete((a, b, np.eye(4), np.zeros((4, 1))), 1.0 / fine)
    states = np.zeros((len(time), 4))
    for i in range(len(time) - 1):
        states[i + 1] = step @ states[i] + load[:, 0] * ground[i]
    roof = (states @ a[3])[:: round(fine / rate)]  # what moves it, over its mass: the absolute acceleration
    nothing = np.full((len(roof), 2), np.nan)
    measured = nothing.copy()
    measured[:, 1] = roof + 0.01 * roof.std() * rng.standard_normal(len(roof))
    return Record(
        time[:: round(fine / rate)], nothing, nothing.copy(), measured, np.zeros_like(nothing), np.ones(2, bool),
        ground_acceleration=ground[:: round(fine / rate)],
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("near", [STOREYS, OTHER], ids=["one", "the other"])
@pytest.mark.parametrize("as_whole", [False, True], ids=["dampers", "rayleigh"])
def test_of_two_structures_that_do_the_same_the_one_nearer_to_what_is_said_is_reported(near, as_whole):
    said = (near * np.array([0.8, 1.2])).tolist()
    damping = {"damping": {"rayleigh": [0.0, RATIO]}} if as_whole else {"c": (RATIO * STOREYS).tolist()}
    chain = build_chain(2, Linear(), m=STOREY, k=said, **damping)
    unknown = ["k_*"] if as_whole else ["k_*", "c_*"]
    problem = StateParameter(unobserved=[], unknown=unknown).pose(chain, [shaken(0)]).alone
    estimate = by_spline(problem)
    found = {p.name: p.estimate for p in estimate.parameters}
    assert [found["k_1"], found["k_2"]] == pytest.approx(near, rel=0.03)
    (rival,) = estimate.rivals
    assert abs(rival.log_odds) < 6.0
