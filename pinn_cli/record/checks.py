"""Faults that the channels of a record show by themselves, with no model of the structure.

``pinn-run inspect`` tells all of them, the verdict on a run the gravest of each sensor. A check takes a record and the
number of one of its channels, and says what is wrong with that channel and what to do, or None.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pinn_cli.record.files.table import mark
from pinn_cli.record.signal import Sampling, Signal
from pinn_cli.record.spectrum import mean_deviation
from pinn_cli.system.quantities import FORCE, GROUND, MOTION, SUPPORT, UNITS

# Equal samples in a row that noise and a converter's steps do not explain; and samples at an extreme value that may be
# there by chance.
CONSTANT_RUN, AT_EXTREME_BY_CHANCE = 8, 2
# A clipped channel has this share of its samples exactly at an extreme value, and at least so many of them.
CLIPPED_SHARE, CLIPPED_SAMPLES = 0.0005, 8
# A coarse converter puts many samples onto every level; onto the outermost no more than a few times as many as onto
# the next (a sine wave: 2.4 times).
CLIPPED_OVER_NEXT = 5
# A run of equal samples is a dropout if the signal moves on average by this share of its rms in that time, and some
# other one has this share of its rms meanwhile: else the structure may be at rest. Levels of a converter so far apart,
# over the rms, are too coarse to tell.
DROPOUT_MOTION, OTHERS_MOVE, COARSE = 0.5, 0.2, 0.1
# An offset, over the channel's rms and over what its lowest frequencies leave open.
LEAST_OFFSET, DEVIATIONS = 0.05, 10.0
# Gravity, in m/s^2 and in g, is recognised within this part of it.
GRAVITY, GRAVITY_WITHIN = 9.80665, 0.02
# Of the mains, Hz. A sine of such a frequency has one phase in all parts of a record, which a mode has by chance alone:
# the statistic of so many parts is F-distributed, and beyond `STEADY_LINE` once in 10^7 times. It is told from such a
# part of the channel's power on; and what acts has a line of its own from `FAINT` on.
MAINS, LINE_PARTS, STEADY_LINE, FAINT, LEAST_HUM = (50.0, 60.0), 8, 50.0, 10.0, 0.05


@dataclass(frozen=True)
class Fault:
    """What is wrong with one channel.

    Attributes:
        kind: One of `CHECKS`.
        signal: The channel.
        text: One sentence: what was found, and what to try.
    """

    kind: str
    signal: Signal
    text: str


@dataclass(frozen=True, eq=False)
class CheckedRecord:
    """Channels as checks see them.

    Attributes:
        signals: All of one record, each with `MINIMUM_SAMPLES` numbers or more.
        sampling: Of their values.
    """

    signals: Sequence[Signal]
    sampling: Sampling

    @cached_property
    def regular(self) -> list[np.ndarray]:
        """(N,) each, at the sampling's regular times."""
        return [self.sampling.on_regular(signal.values) for signal in self.signals]

    @property
    def step(self) -> float:
        """Of the regular times, s."""
        return 1.0 / self.sampling.rate

    @cached_property
    def marks(self) -> list[float | None]:
        """Of each channel the number that marks gaps by its looks; None: there is none. A force may come in blows."""
        return [None if signal.quantity == FORCE else mark(signal.values) for signal in self.signals]

    def faults_of(self, i: int) -> Iterator[Fault]:
        """Of one channel, the gravest first; of one that does not move that is all there is to say."""
        signal = self.signals[i]
        for kind, check in (CHECKS_OF_FORCES if signal.quantity == FORCE else CHECKS).items():
            if told := check(self, i):
                yield Fault(kind, signal, f"{_named(signal)} {told}")
                if kind == "still":
                    return


def _named(signal: Signal) -> str:
    return f"the {signal.name}" if signal.quantity else f"column {signal.name}"


def still(record: CheckedRecord, i: int) -> str | None:
    """One value throughout."""
    x = record.signals[i].there
    return None if np.ptp(x) > 0.0 else f"is {x[0]:.4g} throughout: a dead sensor? leave it out"


def copied(record: CheckedRecord, i: int) -> str | None:
    """The samples of an earlier channel: noise alone would make them differ."""
    values = record.signals[i].values
    for other in record.signals[:i]:
        if np.array_equal(other.values, values, equal_nan=True):
            told = f"is a copy of {_named(other)}: all of its samples are the same"
            return f"{told}; look for its own column, or leave it out"
    return None


def marked(record: CheckedRecord, i: int) -> str | None:
    """A number that several samples are, and that is no measurement by its looks."""
    x, value = record.signals[i].there, record.marks[i]
    if value is None:
        return None
    others = x[x != value]
    where = "as no other number is" if others.min() < value < others.max() else "far from all others"
    told = f"is {value:.6g} in {np.sum(x == value)} samples, {where}"
    return f"{told}: if it marks gaps, name it in data.missing, as the file has it"


def clipped(record: CheckedRecord, i: int) -> str | None:
    """Samples that are exactly the largest or the least value; of what may come in blows, not where it rests."""
    x = record.signals[i].there
    levels, counts = np.unique(x, return_counts=True)
    least = max(CLIPPED_SAMPLES, CLIPPED_SHARE * len(x))
    rest = None if record.signals[i].quantity in (*MOTION, GROUND, *SUPPORT) else np.median(x)
    if len(levels) < 3:
        return None
    ends = [
        end for end, step in ((-1, -1), (0, 1))
        if levels[end] not in (rest, record.marks[i])
        and counts[end] >= max(least, CLIPPED_OVER_NEXT * counts[end + step])
    ]  # fmt: skip
    if not ends:
        return None
    at = " and ".join(f"{levels[end]:.4g}" for end in ends)
    told = f"is clipped at {at}: {100 * counts[ends].sum() / len(x):.2g} % of its samples are exactly that"
    return f"{told}; measure again with a wider range, or leave it out"


def drops_out(record: CheckedRecord, i: int) -> str | None:
    """Equal samples in a row for longer than the channel takes to move, while something else moves."""
    if record.marks[i] is not None:
        return None
    runs = dropouts(record.regular[i], record.regular[:i] + record.regular[i + 1 :])
    if not runs:
        return None
    samples, first = sum(end - begin for begin, end in runs), record.sampling.regular[runs[0][0]]
    told = f"drops out: {samples} samples in {len(runs)} runs do not change, the first at {first:.4g} s"
    return f"{told}; cut these out with data.start and data.stop, or leave it out"


def off_zero(record: CheckedRecord, i: int) -> str | None:
    """A mean that no motion has; a displacement may have one, under a force that has."""
    signal, x = record.signals[i], record.signals[i].there
    quantity = MOTION[2] if signal.quantity == GROUND else SUPPORT.get(signal.quantity, signal.quantity)
    mean, rms = float(np.mean(x)), float(np.std(x))
    is_rate = quantity in MOTION[1:]
    if not is_rate or abs(mean) < LEAST_OFFSET * rms or abs(mean) < DEVIATIONS * mean_deviation(record.regular[i]):
        return None
    gravity = [
        unit
        for unit, g in (("m/s^2", GRAVITY), ("g", 1.0))
        if abs(abs(mean) / g - 1.0) < GRAVITY_WITHIN and abs(mean) > rms
    ]
    if gravity and quantity == MOTION[2]:
        why = f"as of gravity in {gravity[0]}"
    else:
        won, integral = abs(mean) * record.sampling.duration, MOTION[MOTION.index(quantity) - 1]
        why = f"integrated over the record that is a {integral} of {won:.3g} {UNITS[integral]} that nobody had"
    return f"{told_offset(mean, rms)}: {why}; subtract it from its column"


def told_offset(offset: float, rms: float) -> str:
    """How large an offset is, behind the name of a channel with this rms."""
    return f"has an offset of {offset:.4g} ({100 * abs(offset) / rms:.0f} % of its rms)"


def hums(record: CheckedRecord, i: int) -> str | None:
    """A steady line of the mains, which nothing that acts has."""
    acting = [x for j, x in enumerate(record.regular) if j != i and record.signals[j].is_input]
    line = hum(record.regular[i], record.step, acting)
    if line is None:
        return None
    told = f"hums: {100 * line[1]:.0f} % of its power is a steady line at {of_mains(line[0], record.step)}"
    return f"{told}, which nothing that acts has; filter it out, or leave that sensor out"


# The gravest first. What a force does is nobody's fault: it may be the same at two DOFs, come in blows, have a line.
CHECKS: Mapping[str, Callable[[CheckedRecord, int], str | None]] = {
    "still": still,
    "copy": copied,
    "mark": marked,
    "clip": clipped,
    "dropout": drops_out,
    "offset": off_zero,
    "hum": hums,
}
CHECKS_OF_FORCES = {kind: CHECKS[kind] for kind in ("still", "clip")}


def clipped_percent(signal: np.ndarray) -> float:
    """Share of samples (N,) that sit at the channel's own largest or least value, %; 0 of one or two.

    A value that is the median is none that the channel was clipped at: a hammer's force rests at its least value.
    """
    clipped, rest = 0, np.median(signal)
    for extreme in {float(signal.max()), float(signal.min())}:
        count = int(np.sum(signal == extreme))
        clipped += count if count > AT_EXTREME_BY_CHANCE and extreme != rest else 0
    return 100.0 * clipped / len(signal)


def constant_percent(signal: np.ndarray) -> float:
    """Share of samples (N,) in runs of `CONSTANT_RUN` or more equal values, zeros included, %."""
    return 100.0 * sum(end - begin for begin, end in equal_runs(signal)) / len(signal)


def equal_runs(signal: np.ndarray) -> list[tuple[int, int]]:
    """First and last index + 1 of every run of `CONSTANT_RUN` equal samples (N,) or more."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(signal)) + 1, [len(signal)]])
    long = np.flatnonzero(np.diff(edges) >= CONSTANT_RUN)
    return list(zip(edges[long].tolist(), edges[long + 1].tolist(), strict=True))


def dropouts(signal: np.ndarray, others: Sequence[np.ndarray]) -> list[tuple[int, int]]:
    """The same of the runs in which a signal (N,) rests for longer than it takes to move, while one of others moves."""
    if np.min(np.diff(np.unique(signal)), initial=np.inf) > COARSE * np.std(signal):  # it rests on each level
        return []
    return [
        (begin, end) for begin, end in equal_runs(signal)
        if _moves_within(signal, end - begin) and any(np.std(x[begin:end]) > OTHERS_MOVE * np.std(x) for x in others)
    ]  # fmt: skip


def _moves_within(signal: np.ndarray, samples: int) -> bool:
    """Whether a signal moves, over so many samples, by a good part of its rms."""
    lag = max(1, min(samples // 2, len(signal) // 2))
    return bool(np.sqrt(np.mean((signal[lag:] - signal[:-lag]) ** 2)) > DROPOUT_MOTION * np.std(signal))


def hum(signal: np.ndarray, step: float, acting: Sequence[np.ndarray]) -> tuple[float, float] | None:
    """Frequency of the mains, Hz, of which a signal (N,) has a line, and the line's share of its power.

    None where it has none, or where something that acts (N,) has it too: then it may be a machine.
    """
    steadiness, share, line = max((*_steadiness(signal, frequency * step), frequency) for frequency in MAINS)
    if not (steadiness > STEADY_LINE and share > LEAST_HUM):
        return None
    acts = any(_steadiness(other, line * step)[0] > FAINT for other in acting)
    return None if acts else (line, share)


def of_mains(line: float, step: float) -> str:
    """``50 Hz of the mains``, and where the samples show it if they are too few; it may be a line there."""
    shown = abs(line - round(line * step) / step)
    return f"{line:g} Hz of the mains" + (f", or at {shown:.4g} Hz, where its samples show it" if shown < line else "")


def _steadiness(signal: np.ndarray, turns: float) -> tuple[float, float]:
    """How steady a line is, as F with 2 and 2 (`LINE_PARTS` - 1) degrees of freedom, and its share of the power.

    It turns so often from sample to sample; beyond one half it shows where the samples of the signal (N,) put it.
    """
    turns, length = abs(turns - round(turns)), len(signal) // LINE_PARTS
    if min(turns, 0.5 - turns) * length < 2.0:  # no line of its own
        return 0.0, 0.0
    window = np.hanning(length + 2)[1:-1]
    turning = np.exp(-2j * np.pi * turns * np.arange(LINE_PARTS * length))
    turned = (signal - signal.mean())[: LINE_PARTS * length] * turning
    parts = turned.reshape(LINE_PARTS, length) @ (window / window.sum())
    line, variance = abs(parts.mean()) ** 2, float(np.sum(np.abs(parts - parts.mean()) ** 2)) / (LINE_PARTS - 1)
    return LINE_PARTS * line / max(variance, 1e-300), 2.0 * line / max(float(np.var(signal)), 1e-300)
