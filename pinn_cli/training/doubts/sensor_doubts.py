"""What a sensor may show beside what it is said to feel: columns of a gain, a delay, a tilt, a high-pass filter."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_banded  # scipy.signal takes a third of a second to import

from pinn_cli.record.channel import WIDEST_DELAY
from pinn_cli.system.left_out import rms
from pinn_cli.system.quantities import CONNECTION_FORCE, FORCE, GROUND, MOTION, SUPPORT
from pinn_cli.training.factors.channel_at_point import ChannelAtPoint
from pinn_cli.training.normal_equations import NormalEquations

# Kinds, as programs know them.
GAIN, DELAY, TILT, HIGH_PASS = "gain", "delay", "tilt", "high_pass"
# Of sensors of one make on one structure: all may pass no slow motion, or turn as their floors do.
COMMON = (TILT, HIGH_PASS)
# Of a record, the periods of the lowest corner of a filter that is tried; each next one is twice as high, as long as
# what the filter takes has no more than half of the channel's power.
CORNER_PERIODS, MOST_TAKEN = 2.0, 0.5


@dataclass(frozen=True)
class Term:
    """Something that a model may lack.

    Attributes:
        kind: What it is, for programs.
        of: Whose it is, for people: ``connection 2``, ``acceleration of DOF 3``.
        unit: Of its value.
        scale: Value at one prior standard deviation.
        shape: What its column depends on beside: a gap or an elongation at which it yields, m, a frequency, Hz; NaN:
            nothing.
        least, most: Values beyond which it means nothing, or is more than a linear test can tell.
    """

    kind: str
    of: str
    unit: str
    scale: float
    shape: float = np.nan
    least: float = -np.inf
    most: float = np.inf


@dataclass(frozen=True, eq=False)
class SensorTerm:
    """What channels may show beside what they are said to feel.

    Attributes:
        term: What.
        shown: Place of a channel to its column (J,), at one prior standard deviation.
    """

    term: Term
    shown: dict[int, np.ndarray]


def sensor_terms(channels: Sequence[ChannelAtPoint]) -> list[SensorTerm]:
    """Of every channel but those of connections, and of all sensors of a quantity together."""
    terms: list[SensorTerm] = []
    together: defaultdict[tuple[str, str, float], dict[int, tuple[Term, np.ndarray]]] = defaultdict(dict)
    for i, channel in enumerate(channels):
        if channel.quantity == CONNECTION_FORCE:
            continue
        for term, column in columns_of(channel):
            # A force that is larger is a structure that is softer.
            if term.kind in channel.uncertain or (channel.quantity == FORCE and term.kind != DELAY):
                continue
            counted = column * channel.counted
            terms.append(SensorTerm(term, {i: counted}))
            if term.kind in COMMON and channel.quantity in MOTION:
                corner = term.scale if term.kind == HIGH_PASS else 0.0
                together[channel.quantity, term.kind, corner][i] = term, counted
    for (quantity, _, _), of_all in together.items():
        if len(of_all) > 1:
            term = replace(next(iter(of_all.values()))[0], of=f"{quantity} of all sensors")
            terms.append(SensorTerm(term, {i: term.scale / single.scale * by for i, (single, by) in of_all.items()}))
    return terms


def sensor_border(
    equations: NormalEquations, channels: Sequence[ChannelAtPoint], terms: Sequence[SensorTerm]
) -> np.ndarray:
    """(size, D), products of what channels may show with the rows of the readout weights."""
    border = np.zeros((equations.layout.size, len(terms)))
    for i, channel in enumerate(channels):
        places = [d for d, term in enumerate(terms) if i in term.shown]
        if places:
            columns = np.column_stack([terms[d].shown[i] for d in places])
            border[:, places] += channel.sigma**-2 * channel.border(equations.layout, columns)
    return border


def columns_of(channel: ChannelAtPoint) -> Iterator[tuple[Term, np.ndarray]]:
    """What a channel may show, and its column (J,) at one prior standard deviation."""
    step = channel.per_sample * float(np.median(np.diff(channel.time)))
    name, signal, late = channel.name, channel.gain * channel.measurand, WIDEST_DELAY * step
    rate = np.gradient(signal, channel.time)
    yield Term(GAIN, name, "", 1.0, least=-1.0), signal  # nothing is left of the sensor
    yield Term(DELAY, name, "s", late, np.nan, *delays(signal, rate)), -late * rate
    if channel.quantity == "acceleration" and channel.displacement is not None and channel.displacement.any():
        size = rms(signal) / rms(channel.displacement)
        yield Term(TILT, name, "m/s^2 per m", size), size * channel.displacement
    # One that passes more than the others do is one whose others pass less.
    yield from ((Term(HIGH_PASS, name, "Hz", corner, least=0.0), column) for corner, column in _taken(channel).items())


def delays(shown: np.ndarray, rate: np.ndarray) -> tuple[float, float]:
    """The least and the most, s, that a history's rate can tell: the change is then as large as the history."""
    longest = rms(shown) / max(rms(rate), 1e-300)
    return -longest, longest


def _taken(channel: ChannelAtPoint) -> dict[float, np.ndarray]:
    """Corner frequency, Hz, to minus what a high-pass filter of first order takes (J,); none of uneven samples."""
    steps = np.diff(channel.time)
    out: dict[float, np.ndarray] = {}
    differentiated = ("acceleration", "velocity", GROUND)
    if SUPPORT.get(channel.quantity, channel.quantity) not in differentiated or np.ptp(steps) > 0.02 * steps[0]:
        return out
    corner, signal = CORNER_PERIODS / (channel.time[-1] - channel.time[0]), channel.gain * channel.measurand
    while True:
        kept = float(np.exp(-2.0 * np.pi * corner * steps[0]))
        slow = solve_banded((1, 0), np.outer((1.0, -kept), np.ones(len(signal))), (1.0 - kept) * signal)
        if rms(slow) ** 2 > MOST_TAKEN * rms(signal) ** 2 or not signal.any():
            return out
        out[corner], corner = -slow, 2.0 * corner
