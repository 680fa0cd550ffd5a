"""Records of frames that unknown forces shake, by numpy and scipy alone: exact steps at a fine rate, decimated."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.signal import fftconvolve, firwin
from storeys import chain_matrix

from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.system.structure import Structure
from pinn_cli.system.topology import build_structure

FINE_RATE = 800.0


@dataclass(frozen=True, eq=False)
class AmbientRecord:
    """What is known of a frame, and what it does."""

    structure: Structure
    record: Record
    truth: Response
    noise: float


def frame(floors: int, first_frequency: float, damping: float = 0.02) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses kg, dampers N s/m and springs N/m of a frame with a first frequency, Hz."""
    m, k = np.full(floors, 1000.0), np.linspace(1.3, 1.0, floors)
    rate = np.sqrt(np.linalg.eigvalsh(chain_matrix(k) / 1000.0)[0])
    k = k * (2.0 * np.pi * first_frequency / rate) ** 2
    return m, 2.0 * damping / (2.0 * np.pi * first_frequency) * k, k


def storeys(*each: Mapping[str, object]) -> tuple[list[str], dict[str, dict[str, object]]]:
    """Names of floors from the ground up, and the storeys below them with these laws and values."""
    names = [f"x{i}" for i in range(len(each))]
    return names, {f"storey_{i}": {"between": ["ground", *names][i : i + 2], **own} for i, own in enumerate(each)}


def white_below(edge: float, rate: float, shape: tuple[int, ...], random: np.random.Generator) -> np.ndarray:
    """Unit white noise up to a frequency, Hz, at a rate, over the first of its axes."""
    spectrum = np.fft.rfft(random.standard_normal(shape), axis=0)
    spectrum[np.fft.rfftfreq(shape[0], 1.0 / rate) > edge] = 0.0
    force = np.fft.irfft(spectrum, shape[0], axis=0)
    return force / force.std()


def ambient_record(
    first_frequency: float,
    rate: float,
    duration: float,
    edge: float | None = None,
    corner: float | None = None,
    floors: int = 3,
    sensors: tuple[int, ...] = (0, 2),
    seed: int = 0,
    snr_db: float = 30.0,
) -> AmbientRecord:
    """Accelerations of a frame with forces of 100 N on all floors.

    Args:
        first_frequency: Of the frame, Hz.
        rate: Of the record, Hz.
        duration: s.
        edge: Up to which the forces are white, Hz; None: white at all frequencies, before anti-alias filters.
        corner: Above which they fall off, as an Ornstein-Uhlenbeck process does, Hz; None: they do not.
        floors: Their number.
        sensors: Floors with an accelerometer, from 0.
        seed: Of forces and noise.
        snr_db: Of the sensors.
    """
    m, c, k = frame(floors, first_frequency)
    random, step, every = np.random.default_rng(seed), 1.0 / FINE_RATE, round(FINE_RATE / rate)
    before = round(10.0 / first_frequency * FINE_RATE)
    times = before + round((duration + 1.0) * FINE_RATE)
    if edge is None:
        force = random.standard_normal((times, floors)) * np.sqrt(every)
    else:
        force = white_below(edge, FINE_RATE, (times, floors), random)
    if corner is not None:
        spectrum, frequency = np.fft.rfft(force, axis=0), np.fft.rfftfreq(times, step)
        force = np.fft.irfft(spectrum / np.sqrt(1.0 + (frequency / corner) ** 2)[:, None], times, axis=0)
        force /= force.std()
    force *= 100.0
    system = np.block(
        [[np.zeros((floors, floors)), np.eye(floors)], [-chain_matrix(k) / 1000.0, -chain_matrix(c) / 1000.0]]
    )
    both = np.zeros((3 * floors, 3 * floors))
    both[: 2 * floors, : 2 * floors], both[floors : 2 * floors, 2 * floors :] = system, np.eye(floors) / 1000.0
    moved = expm(both * step)
    a, b = moved[: 2 * floors, : 2 * floors], moved[: 2 * floors, 2 * floors :]
    states = np.zeros((times, 2 * floors))
    for i in range(times - 1):
        states[i + 1] = a @ states[i] + b @ force[i]
    acceleration = (states @ system.T)[:, floors:] + force / m
    histories = [states[:, :floors], states[:, floors:], acceleration, force]
    if edge is None:
        low_pass = firwin(32 * every + 1, 0.4 * rate, fs=FINE_RATE)[:, None]
        histories = [fftconvolve(x, low_pass, mode="same", axes=0) for x in histories]
    kept = slice(before, before + round(duration * FINE_RATE) + 1, every)
    u, v, a, f = (x[kept] for x in histories)
    time = np.arange(len(u)) / rate
    noise = 10.0 ** (-snr_db / 20.0) * float(a.std())
    measured = np.full_like(a, np.nan)
    measured[:, sensors] = a[:, sensors] + noise * random.standard_normal((len(a), len(sensors)))
    nothing = np.full_like(a, np.nan)
    unforced = np.zeros(floors, dtype=bool)
    record = Record(time, nothing, nothing.copy(), measured, nothing.copy(), unforced=unforced)
    names, connections = storeys(*({"law": "linear", "c": a, "k": b} for a, b in zip(c, k, strict=True)))
    structure = build_structure(names, dict(zip(names, m, strict=True)), connections)
    return AmbientRecord(structure, record, Response(time, u, v, a, f), noise)
