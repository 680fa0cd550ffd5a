"""What happens to records and to models in practice: a case with one fault of a channel, of the clock or of the model.

A fault matters where it changes its channel by `LEAST` of its rms or more. With 10 dB of noise, the most that a family
has, that is half of the noise, and it is there at every sample: some hundred of them tell it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter

from benchmarks.trust.case import HERE, Case
from benchmarks.trust.wrong_models import MODEL_FAULTS

RESPONSES = ("displacement", "velocity", "acceleration")
LEAST = 0.15
# What two units taken for each other make of a channel.
UNITS = {
    "displacement": (1e3, 1e-3, 25.4, 1 / 0.0254),
    "velocity": (1e3, 1e-3),
    "acceleration": (9.80665, 1 / 9.80665, 1e3),
    "force": (1e3, 1e-3, 4.4482216, 9.80665),
    "ground_acceleration": (9.80665, 1 / 9.80665, 0.01),
}
# What the verdict says of a sensor that is wrong in a way for which it has no word.
ODD = "{0} alone is not|residual of the {0} is not white|{0} fits DOF"


@dataclass(frozen=True)
class Channel:
    """A column of a case that the settings use.

    Attributes:
        file: Of `Case.records`.
        column: In it.
        quantity: `displacement`, ..., `force` or `ground_acceleration`.
        dof: As the settings have it; None: of the ground, or of several.
        doubted: What the settings doubt of its calibration.
    """

    file: str
    column: str
    quantity: str
    dof: object
    doubted: frozenset[str] = frozenset()

    @property
    def name(self) -> str:
        """As the verdict has it, as a regular expression."""
        if self.quantity == "ground_acceleration":
            return r"\bground('s)? acceleration"
        return rf"\b{self.column}\b" if self.dof is None else rf"{self.quantity} of DOF {self.dof}\b"


def channels(case: Case) -> Iterator[Channel]:
    """Every column that measures something, record by record."""
    data: dict[str, Any] = dict(case.settings["data"])  # type: ignore[call-overload]
    for entry in data.get("records") or [{}]:
        own = data | entry
        file = str(own["path"]).removeprefix(f"{HERE}/")
        for quantity in (*RESPONSES, "force"):
            for dof, column in (own.get(quantity) or {}).items():
                if column is not None:
                    yield Channel(file, column, quantity, dof)
        if own.get("ground_acceleration"):
            yield Channel(file, own["ground_acceleration"], "ground_acceleration", None)
        for column, said in (own.get("channels") or {}).items():
            doubted = {key for key in ("gain", "offset", "drift", "delay") if not _known(said.get(key))}
            yield Channel(file, said.get("column", column), said["sensor"], said.get("dof"), frozenset(doubted))


def _known(value: object) -> bool:
    return value is None or isinstance(value, int | float)


@dataclass(frozen=True)
class ChannelFault:
    """A fault of one channel.

    Attributes:
        change: Samples (N,), their times and the units that its quantity may be mistaken in, to other samples.
        words: That name it, `{0}` for the channel.
        hidden_by: Of its calibration, in doubt: then it is no fault.
        scales: It shows only beside a measured input or two other sensors.
        inputs: It may be a load cell's or the ground's.
    """

    change: Callable[[Generator, np.ndarray, np.ndarray, tuple[float, ...]], np.ndarray]
    words: str
    hidden_by: str = ""
    scales: bool = False
    inputs: bool = False

    def __call__(self, case: Case, rng: Generator) -> Case | None:
        """The case with the fault; None where no channel can have it."""
        every = list(channels(case))
        inputs = [c for c in every if c.quantity not in RESPONSES]
        if self.scales and not inputs and len(every) < 3:
            return None
        hosts = [c for c in every if c.quantity in RESPONSES and self.hidden_by not in c.doubted]
        if self.inputs and inputs and rng.random() < 0.25:
            hosts = [c for c in inputs if self.hidden_by not in c.doubted]
        for i in rng.permutation(len(hosts)):
            table = case.records[hosts[i].file]
            x, t = table[hosts[i].column].to_numpy(), table["t"].to_numpy()
            if not np.isfinite(x).all():
                continue
            y = self.change(rng, x, t, UNITS[hosts[i].quantity])
            if matters(x, y):
                alone = "|with one sensor, the force may be what is off" if hosts[i] in inputs else ""
                return with_column(case, hosts[i], y, self.words.format(hosts[i].name) + alone)
        return None


def matters(x: np.ndarray, y: np.ndarray, least: float = LEAST) -> bool:
    """Whether samples are changed by a part of their rms."""
    return bool(np.sqrt(np.mean((y - x) ** 2)) >= least * x.std())


def with_column(case: Case, channel: Channel, y: np.ndarray, names_it: str) -> Case:
    """The case with other samples in one column."""
    table = case.records[channel.file].assign(**{channel.column: y})
    return replace(case, records=case.records | {channel.file: table}, truth=replace(case.truth, names_it=names_it))


def unit(rng: Generator, x: np.ndarray, t: np.ndarray, units: tuple[float, ...]) -> np.ndarray:
    """Such as g for m/s^2, mm for m, kN for N."""
    return x * float(rng.choice(units))


def gain(rng: Generator, x: np.ndarray, t: np.ndarray, units: tuple[float, ...]) -> np.ndarray:
    """15 to 100 % too much, or 15 to 50 % too little."""
    return x * float(rng.choice([rng.uniform(1.15, 2.0), rng.uniform(0.5, 0.85)]))


def offset(rng: Generator, x: np.ndarray, t: np.ndarray, units: tuple[float, ...]) -> np.ndarray:
    """0.3 to 3 times the rms."""
    return x + float(rng.choice([-1, 1]) * rng.uniform(0.3, 3.0)) * x.std()


def sign(rng: Generator, x: np.ndarray, t: np.ndarray, units: tuple[float, ...]) -> np.ndarray:
    """The sensor is the other way round."""
    return -x


def delay(rng: Generator, x: np.ndarray, t: np.ndarray, units: tuple[float, ...]) -> np.ndarray:
    """3 to 6 samples, and more until it matters twice."""
    late = int(rng.integers(3, 7))
    while late < len(x) // 50 and not matters(x, shifted(x, late), 2 * LEAST):
        late += 1
    return shifted(x, late)


def shifted(x: np.ndarray, late: int) -> np.ndarray:
    """So many samples late; at rest before."""
    return np.r_[np.full(late, x[0]), x[:-late]]


def clip(rng: Generator, x: np.ndarray, t: np.ndarray, units: tuple[float, ...]) -> np.ndarray:
    """At 0.7 to 1.3 times the rms."""
    most = float(rng.uniform(0.7, 1.3)) * x.std()
    return x.clip(-most, most)


def dropout(rng: Generator, x: np.ndarray, t: np.ndarray, units: tuple[float, ...]) -> np.ndarray:
    """Two to five stretches of 2 to 6 % of the record are zero, or keep the last value."""
    y, holds = x.copy(), rng.random() < 0.5
    for begin in rng.uniform(0.1, 0.9, int(rng.integers(2, 6))):
        first = int(begin * len(x))
        y[first : first + int(rng.uniform(0.02, 0.06) * len(x))] = x[first] if holds else 0.0
    return y


def hum(rng: Generator, x: np.ndarray, t: np.ndarray, units: tuple[float, ...]) -> np.ndarray:
    """50 or 60 Hz, as its samples show it, of 0.3 to 1 times the rms."""
    angle = 2.0 * np.pi * float(rng.choice([50.0, 60.0])) * t + rng.uniform(0.0, 2.0 * np.pi)
    return x + np.sqrt(2.0) * rng.uniform(0.3, 1.0) * x.std() * np.sin(angle)


def lowpass(rng: Generator, x: np.ndarray, t: np.ndarray, units: tuple[float, ...]) -> np.ndarray:
    """An analogue filter of second order with a corner among the frequencies at which the channel has its power."""
    power = np.abs(np.fft.rfft(x - x.mean())) ** 2
    half = np.searchsorted(power.cumsum(), 0.5 * power.sum()) / (len(power) - 1)
    b, a = butter(2, float(np.clip(half * rng.uniform(0.7, 1.5), 0.01, 0.8)))
    return np.asarray(lfilter(b, a, x))


def quantisation(case: Case, rng: Generator) -> Case | None:
    """8 bits over a range of 8 to 25 times the largest value: noise of 0.07 to 0.25 of the rms, as a rule."""
    hosts = [c for c in channels(case) if c.quantity in RESPONSES]
    for i in rng.permutation(len(hosts)):
        x = case.records[hosts[i].file][hosts[i].column].to_numpy()
        step = 2.0 * float(rng.uniform(8, 25)) * np.nanmax(np.abs(x)) / 256
        y = np.round(x / step) * step
        if np.isfinite(x).all() and matters(x, y, LEAST / 3.0):
            words = "{0}.*(level|coarse|converter|quanti|resolution|bits)|" + ODD
            return with_column(case, hosts[i], y, words.format(hosts[i].name))
    return None


def exchange(case: Case, rng: Generator) -> Case | None:
    """Two sensors of one kind, each in the other's column."""
    for a, b, x, y in _pairs(case, rng):
        places = rf"{a.quantity} of DOFs ({a.dof} and {b.dof}|{b.dof} and {a.dof})\b"
        words = rf"{places} fit|{a.name} fits DOF {b.dof}|{b.name} fits DOF {a.dof}"
        return with_column(with_column(case, a, y, ""), b, x, words)
    return None


def duplicate(case: Case, rng: Generator) -> Case | None:
    """One channel is a copy of another one."""
    for a, b, x, _ in _pairs(case, rng):
        same = rf"({a.name}|{b.name}).*(same|copy|copies|identical|equal|duplicate)"
        return with_column(case, b, x, f"{same}|{ODD.format(b.name)}")
    return None


def _pairs(case: Case, rng: Generator) -> Iterator[tuple[Channel, Channel, np.ndarray, np.ndarray]]:
    """Two sensors of one kind, of one record, that measure different things, and their samples."""
    hosts = [c for c in channels(case) if c.quantity in RESPONSES and c.dof is not None and not c.doubted]
    for i in rng.permutation(len(hosts)):
        for j in rng.permutation(len(hosts)):
            a, b = hosts[i], hosts[j]
            x, y = (case.records[c.file][c.column].to_numpy() for c in (a, b))
            alike = (a.file, a.quantity) == (b.file, b.quantity) and a.dof != b.dof
            if alike and np.isfinite(x + y).all() and matters(x, y, 2 * LEAST) and matters(y, x, 2 * LEAST):
                yield a, b, x, y


def clock(case: Case, rng: Generator) -> Case | None:
    """1 to 4 % wrong: of all where everything is known; else of one channel, which a logger of its own has recorded.

    Stiffnesses and dampers that are free make up for a clock that all channels share: no record tells it.
    """
    wrong = 1.0 + float(rng.choice([-1, 1]) * rng.uniform(0.01, 0.04))
    scheme: Any = case.settings.get("scheme", {})
    if "system" in case.settings and not scheme.get("unknown") and not scheme.get("parameter_uncertainty"):
        name = next(channels(case)).file
        table = case.records[name]
        truth = replace(case.truth, names_it=r"\bclock\b|time (axis|column)|sampling rate|the time is in")
        return replace(case, records=case.records | {name: table.assign(t=table["t"] * wrong)}, truth=truth)

    def drifts(rng: Generator, x: np.ndarray, t: np.ndarray, units: tuple[float, ...]) -> np.ndarray:
        return np.asarray(CubicSpline(t, x)((t * wrong).clip(max=t[-1])))

    if len(list(channels(case))) < 2:
        return None
    return ChannelFault(drifts, r"{0}.*(clock|late\b|early\b)|" + ODD)(case, rng)


FACTOR = "{0} (is|shows) .*times"
FAULTS: dict[str, Callable[[Case, Generator], Case | None]] = {
    "unit": ChannelFault(unit, FACTOR, "gain", True, True),
    "gain": ChannelFault(gain, FACTOR, "gain", True, True),
    "offset": ChannelFault(offset, "{0} has an offset", "offset"),
    "sign": ChannelFault(sign, "{0} is the negative of|{0} (is|shows) -.*times", "", True, True),
    "exchange": exchange,
    "delay": ChannelFault(delay, r"{0} is .*(late|early)\b", "delay", False, True),
    "clock": clock,
    "clipping": ChannelFault(clip, "{0} is clipped"),
    "dropout": ChannelFault(dropout, "{0} drops out"),
    "duplicate": duplicate,
    "quantisation": quantisation,
    "hum": ChannelFault(hum, r"{0}.*\b(hum|line|mains)\b|" + ODD),
    "lowpass": ChannelFault(lowpass, r"{0}.*(filter|late\b)|" + ODD),
    **MODEL_FAULTS,
}


def spoil(case: Case, rng: Generator, name: str) -> Case:
    """The case with the fault of that name, or with the next of the list that it can have."""
    names = list(FAULTS)
    for i in range(len(names)):
        fault = names[(names.index(name) + i) % len(names)]
        found = FAULTS[fault](case, rng)
        if found is not None:
            return replace(found, fault=fault, peer=None)
    raise ValueError(f"{case.name} can have no fault")
