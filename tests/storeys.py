"""Records of a linear frame of three storeys in SI units, simulated exactly step by step with scipy alone."""

from functools import cache
from pathlib import Path

import numpy as np
from independent_records import IndependentRecord, Structure, chain_matrix, measured
from scipy.linalg import expm

from pinn_cli.record.record import Record
from pinn_cli.record.response import Response

M = np.array([2000.0, 2000.0, 1500.0])
K = np.array([1.5e6, 1.4e6, 1.2e6])
C = 2e-3 * K
RATE, DURATION = 50.0, 12.0


def under_waves(
    m: np.ndarray,
    damping_and_stiffness: tuple[np.ndarray, np.ndarray],
    acting: np.ndarray,
    waves: tuple[np.ndarray, np.ndarray],
    time: np.ndarray,
    rate: float,
    start: np.ndarray | None = None,
) -> tuple[np.ndarray, ...]:
    """Displacement, velocity and acceleration (N, n) under a sum of cosines, and that sum (N,).

    Args:
        m: Masses (n,), kg.
        damping_and_stiffness: Matrices (n, n), N s/m and N/m.
        acting: Forces (n,) where the sum is one, N.
        waves: Angular frequencies, rad/s, and phases of the cosines; each is a state of the exact transition matrix.
        time: Of the samples (N,), s.
        rate: Of the samples, Hz.
        start: Displacement and velocity (2 n,) at the first sample; None: at rest.
    """
    (omega, phase), (c, k), n = waves, damping_and_stiffness, len(m)
    cosine = 2 * n + 2 * np.arange(len(omega))
    generator = np.zeros((2 * (n + len(omega)),) * 2)
    generator[:n, n : 2 * n] = np.eye(n)
    generator[n : 2 * n, :n], generator[n : 2 * n, n : 2 * n] = -k / m[:, None], -c / m[:, None]
    generator[n : 2 * n, cosine] = (acting / m)[:, None]
    generator[cosine, cosine + 1], generator[cosine + 1, cosine] = -omega, omega
    state = np.zeros(len(generator))
    state[: 2 * n] = 0.0 if start is None else start
    state[cosine], state[cosine + 1] = np.cos(omega * time[0] + phase), np.sin(omega * time[0] + phase)
    step, states = expm(generator / rate), [state]
    while len(states) < len(time):
        states.append(step @ states[-1])
    found = np.array(states)
    return found[:, :n], found[:, n : 2 * n], (found @ generator.T)[:, n : 2 * n], found[:, cosine].sum(axis=1)


def response(
    seed: int,
    k: np.ndarray = K,
    duration: float = DURATION,
    start: np.ndarray | None = None,
    first: float = 0.0,
    most: float = 9.0,
) -> Response:
    """Motion under sinusoids on the roof.

    Args:
        seed: Of the force.
        k: Springs, N/m.
        duration: s.
        start: Displacement and velocity (6,) at the first sample; None: at rest.
        first: Time of the first sample, s.
        most: Greatest frequency of the force, Hz.
    """
    rng = np.random.default_rng([seed, 7])
    waves = 2.0 * np.pi * rng.uniform(0.5, most, 40), rng.uniform(0.0, 2.0 * np.pi, 40)
    acting = np.array([0.0, 0.0, 2000.0 * np.sqrt(2.0 / 40)])
    time = first + np.arange(round(duration * RATE)) / RATE
    *motion, sum_of_waves = under_waves(M, (chain_matrix(C), chain_matrix(k)), acting, waves, time, RATE, start)
    return Response(time, *motion, np.outer(sum_of_waves, acting))


@cache
def record(seed: int, third: float = 1.0, duration: float = DURATION, snr_db: float = 30.0) -> IndependentRecord:
    """A record of accelerometers on all storeys; ``third`` is what is left of the third spring."""
    k = K * np.array([1.0, 1.0, third])
    structure = Structure(M, C, k, np.zeros(3))
    return measured(structure, response(seed, k, duration), {"acceleration": (1, 2, 3)}, snr_db, seed)


def cut(whole: Record, samples: slice) -> Record:
    """A part of a record."""
    channels = {q: getattr(whole, q)[samples] for q in ("displacement", "velocity", "acceleration", "force")}
    return Record(whole.time[samples], **channels, unforced=whole.unforced)


def written(whole: Record, file: Path) -> tuple[str, ...]:
    """The record as a file, and the settings that name its columns."""
    columns = {"t": whole.time, "f": whole.force[:, 2], **{f"a{i + 1}": whole.acceleration[:, i] for i in range(3)}}
    values = np.column_stack(list(columns.values()))
    np.savetxt(file, values, delimiter=",", header=",".join(columns), comments="", fmt="%.12g")
    sensors = "data.acceleration={1: a1, 2: a2, 3: a3}"
    return ("data=csv", f"data.path={file}", "data.time=t", "data.force={3: f}", sensors, "figures=false")


def system(k: np.ndarray = K) -> tuple[str, ...]:
    """Settings of the structure."""
    lists = (f"system.{kind}={values.tolist()}" for kind, values in (("m", M), ("c", C), ("k", k)))
    return ("system=linear", "system.ndof=3", *lists)
