"""Records of a chain whose connections or sensors do more than its model says, made with numpy and scipy alone."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import bilinear, lfilter, lsim

from pinn_cli.record.channel import Calibration, Channel
from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.scheme.calibration import sensor_parameters
from pinn_cli.scheme.problem import Problem, inputs_of
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.parameters import Parameter

RATE, DURATION, STEPS = 50.0, 20.0, 8
M = np.array([9e3, 11e3, 8e3])
K = np.array([4.2e6, 3.6e6, 3.1e6])
C = np.array([1.1e4, 8e3, 9e3])
# Where no connection is: between the first floor and the roof, and from the second floor and the roof to the ground.
LINKS = np.array([[-1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


@cache
def moved(ground: bool, seed: int, terms: tuple[tuple[str, int, float], ...]) -> Response:
    """The chain under a motion of the ground, or a force on its roof, from rest; classical Runge-Kutta.

    Args:
        ground: Which of both.
        seed: Of its phases; content from 0.2 to 8 Hz.
        terms: ``cubic`` N/m^3, ``quadratic`` N (s/m)^2, ``friction`` N, ``one_sided`` N/m, ``one_way`` N s/m or ``gap``
            m, of a connection counted from 0; ``rocking``, of whichever: the part of its base of what gives way to a
            turning moment; ``link`` N/m, of one of `LINKS`.
    """
    rng = np.random.default_rng(seed)
    half = np.arange(2 * STEPS * round(RATE * DURATION) + 1) / (2.0 * STEPS * RATE)
    frequency = np.linspace(0.2, 8.0, 120)
    phase = rng.uniform(0.0, 2.0 * np.pi, len(frequency))
    acting = np.cos(2.0 * np.pi * np.outer(half, frequency) + phase).sum(1) / len(frequency) ** 0.5
    acting *= np.minimum(1.0, half) * (1.4 if ground else 1.2e4)
    rows, roof = np.eye(3) - np.eye(3, k=-1), np.array([0.0, 0.0, 1.0])
    kinds = "cubic", "quadratic", "friction", "one_sided", "one_way", "gap", "rocking", "link"
    of = {kind: np.zeros(3) for kind in kinds}
    for kind, connection, value in terms:
        of[kind][connection] = value

    def rate(state: np.ndarray, load: float) -> np.ndarray:
        e, de = (x - of["rocking"].sum() * K @ x / K.sum() for x in state @ rows.T)
        force = K * e + C * de + of["cubic"] * e**3 + of["quadratic"] * abs(de) * de
        force = force + of["friction"] * np.tanh(de / 1e-3) + of["one_sided"] * np.maximum(e, 0.0)
        force = force - K * np.clip(e, -of["gap"], of["gap"]) + of["one_way"] * np.maximum(de, 0.0)
        pull = -force @ rows - (of["link"] * (LINKS @ state[0])) @ LINKS
        pull = pull - M * load if ground else pull + load * roof
        return np.array((state[1], pull / M))

    step, state, found = 1.0 / (STEPS * RATE), np.zeros((2, 3)), []
    for i in range(round(RATE * DURATION)):
        found.append((*state, rate(state, acting[2 * STEPS * i])[1]))
        for j in range(2 * STEPS * i, 2 * STEPS * (i + 1), 2):
            k1 = rate(state, acting[j])
            k2 = rate(state + 0.5 * step * k1, acting[j + 1])
            k3 = rate(state + 0.5 * step * k2, acting[j + 1])
            k4 = rate(state + step * k3, acting[j + 2])
            state = state + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    u, v, a = np.array(found).swapaxes(0, 1)
    sampled = acting[: -1 : 2 * STEPS]
    force = np.zeros_like(a)
    if not ground:
        force[:, 2] = sampled
    time = half[: -1 : 2 * STEPS]
    return Response(time, u, v, a + sampled[:, None] * ground, force, sampled if ground else None)


def with_oscillator(frequency: float, seed: int, snr_db: float = 60.0) -> tuple[Record, np.ndarray]:
    """Force and displacement of 12 kg on a spring of 7500 N/m which carry 0.36 kg more, swinging so, Hz, if held.

    Returns:
        The record (15 s at 200 Hz), and the two natural frequencies, Hz.
    """
    rng, time = np.random.default_rng(seed), np.arange(3000) / 200.0
    lines = np.linspace(0.8, 10.0, 90)
    load = 5.0 * np.cos(2.0 * np.pi * np.outer(time, lines) + rng.uniform(0.0, 2.0 * np.pi, 90)).sum(1)
    load *= np.minimum(1.0, time)
    spring = 0.36 * (2.0 * np.pi * frequency) ** 2
    mass, k = np.diag([12.0, 0.36]), np.array([[7500.0 + spring, -spring], [-spring, spring]])
    c = np.array([[12.3, -0.3], [-0.3, 0.3]])
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(mass, k), -np.linalg.solve(mass, c)]])
    _, _, state = lsim((a, np.array([[0.0], [0.0], [1.0 / 12.0], [0.0]]), np.eye(4), np.zeros((4, 1))), load, time)
    noisy = (x + 10.0 ** (-snr_db / 20.0) * x.std() * rng.standard_normal(len(x)) for x in (state[:, 0], load))
    shown, force = (x[:, None] for x in noisy)
    absent = np.full_like(shown, np.nan)
    record = Record(time, shown, absent, absent, force, unforced=np.array([False]))
    return record, np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, k)).real) / (2.0 * np.pi)


def high_passed(y: np.ndarray, corner: float, order: int) -> np.ndarray:
    """Histories (N, n) behind a filter of first or second order (Butterworth), Hz, that starts at rest.

    The rule of trapezia in sixteen steps between two samples, through which a spline of seventh degree goes.
    """
    w, count = 2.0 * np.pi * corner, 16 * (len(y) - 1) + 1
    b, a = (([1.0, 0.0], [1.0, w]), ([1.0, 0.0, 0.0], [1.0, 2.0**0.5 * w, w**2]))[order - 1]
    dense = make_interp_spline(np.arange(len(y)), y, 7)(np.linspace(0, len(y) - 1, count))
    return lfilter(*bilinear(b, a, 16 * RATE), dense, axis=0)[::16]


def recorded(truth: Response, spoilt: Mapping[int, np.ndarray] | None = None, snr_db: float = 40.0) -> Record:
    """Noisy accelerometers on all floors, and what acts; ``spoilt`` are noise-free channels in place of others."""
    rng = np.random.default_rng(11)
    shown = truth.acceleration.copy()
    for dof, channel in (spoilt or {}).items():
        shown[:, dof] = channel

    def noisy(x: np.ndarray) -> np.ndarray:
        return x + 10.0 ** (-snr_db / 20.0) * x.std(axis=0) * rng.standard_normal(x.shape)

    absent = np.full_like(shown, np.nan)
    ground = None if truth.ground_acceleration is None else noisy(truth.ground_acceleration)
    unforced = np.array([True, True, ground is not None])
    force = truth.force if ground is not None else noisy(truth.force)
    return Record(truth.time, absent, absent, noisy(shown), force, unforced=unforced, ground_acceleration=ground)


def calibrated_alike(record: Record, filter_order: int = 0, **calibration: Calibration) -> Record:
    """The same accelerometers with one calibration."""
    of = calibration, -1, True, filter_order
    calibrated = tuple(
        Channel(f"a{i + 1}", "acceleration", {i: 1.0}, record.time, record.acceleration[:, i], *of) for i in range(3)
    )
    return replace(record, calibrated=calibrated)


def posed(record: Record, **prescribed: list[float]) -> Problem:
    """The linear chain with unknown springs and dampers, which start 10 to 30 % off; masses as given or right."""
    chain = build_chain(
        3, Linear(), **{"m": M.tolist(), "c": (1.3 * C).tolist(), "k": (0.9 * K).tolist(), **prescribed}
    )
    uncertain = tuple(
        Parameter(kind, i, float(chain.parameters[kind][i]), 10.0 * float(values[i]), unknown=True, positive=True)
        for kind, values in (("c", C), ("k", K))
        for i in range(3)
    )
    return Problem(chain, record, (*uncertain, *sensor_parameters(record)), inputs=inputs_of(chain, record))
