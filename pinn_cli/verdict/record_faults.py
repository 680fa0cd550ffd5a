"""What a channel says against itself: still, a copy, clipped, dropped out, off its zero, humming, far off at first."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.channel import Channel
from pinn_cli.record.channels import channels, dropouts, hum, of_mains
from pinn_cli.record.files.table import told_mark
from pinn_cli.record.response import MEASURED_QUANTITIES, RESPONSE_QUANTITIES
from pinn_cli.record.spectrum import mean_deviation
from pinn_cli.system.quantities import FORCE, GROUND, SUPPORT
from pinn_cli.verdict.finding import Finding

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.training.estimate import Estimate

# A clipped channel has this share of its samples exactly at an extreme value, and at least so many of them.
CLIPPED_SHARE, CLIPPED_SAMPLES = 0.002, 8
# A coarse converter puts many samples onto every level; onto the outermost no more than a few times as many as onto
# the next (a sine wave: 2.4 times).
CLIPPED_OVER_NEXT = 5
# An offset, over the channel's rms and over what its lowest frequencies leave open.
LEAST_OFFSET, DEVIATIONS = 0.05, 10.0
# The beginning of a record, as a share of it. It is far off where what is left there is so large a part of the signal,
# and so many times what is left of the rest.
BEGINNING, FAR_OFF, ABOVE_REST = 0.02, 0.5, 5.0


def record_faults(record: Record) -> list[Finding]:
    """The faults of all channels, at most one of each."""
    tests = (_still, _copied, _marked, _clipped, _dropped_out, _off_zero, _hums)
    return [
        first_fault
        for channel in channels(record, (*RESPONSE_QUANTITIES, GROUND, *SUPPORT))
        if (first_fault := next((fault for test in tests if (fault := test(channel, record)) is not None), None))
        is not None
    ]


def _still(channel: Channel, record: Record) -> Finding | None:
    if np.ptp(channel.measured) > 0:
        return None
    text = f"the {channel.name} is {channel.measured[0]:.4g} throughout; leave that sensor out"
    return Finding("still", channel.name, text, "failed")


def _copied(channel: Channel, record: Record) -> Finding | None:
    """The same samples as another channel before it: noise alone would make them differ."""
    for other in channels(record, (*RESPONSE_QUANTITIES, GROUND, *SUPPORT)):
        if other.name == channel.name:
            return None
        if np.array_equal(other.measured, channel.measured):
            text = f"the {channel.name} is a copy of the {other.name}: all of its samples are the same"
            return Finding("copy", channel.name, f"{text}; look for its own column, or leave it out")
    return None


def _marked(channel: Channel, record: Record) -> Finding | None:
    """A constant far from everything else that was measured."""
    told = told_mark(channel.measured)
    return None if told is None else Finding("mark", channel.name, f"the {channel.name} {told}")


def _clipped(channel: Channel, record: Record) -> Finding | None:
    """Samples piled up exactly at the largest or the smallest value."""
    levels, counts = np.unique(channel.measured, return_counts=True)
    least = max(CLIPPED_SAMPLES, CLIPPED_SHARE * len(channel.measured))
    for end, step in ((-1, -1), (0, 1)):
        if len(levels) > 2 and counts[end] >= least and counts[end] >= CLIPPED_OVER_NEXT * counts[end + step]:
            share = 100 * counts[end] / len(channel.measured)
            text = f"the {channel.name} is clipped at {levels[end]:.4g}: {share:.1f} % of its samples are exactly that"
            return Finding("clip", channel.name, f"{text}; measure again with a wider range, or leave it out")
    return None


def _dropped_out(channel: Channel, record: Record) -> Finding | None:
    """Equal samples in a row for longer than the channel takes to move, while something else moves."""
    runs = dropouts(channel.measured, [c.measured for c in channels(record, MEASURED_QUANTITIES, [channel.name])])
    if not runs:
        return None
    samples = sum(end - begin for begin, end in runs)
    first = record.time[runs[0][0]]
    text = (
        f"the {channel.name} drops out: {samples} samples in {len(runs)} runs do not change, the first at {first:.4g} s"
    )
    return Finding("dropout", channel.name, f"{text}; cut these out with data.start and data.stop, or leave it out")


def _off_zero(channel: Channel, record: Record) -> Finding | None:
    """A mean that no motion has: an acceleration's is the velocity won over the duration, a velocity's the way gone.

    A displacement may have one, under a force that has.
    """
    if channel.order == 0:
        return None
    x, rms = channel.measured, float(np.std(channel.measured))
    mean = float(np.mean(x))
    if abs(mean) < LEAST_OFFSET * rms or abs(mean) < DEVIATIONS * mean_deviation(x):
        return None
    text = f"the {channel.name} has an offset of {mean:.4g} ({100 * abs(mean) / rms:.0f} % of its rms)"
    return Finding("offset", channel.name, f"{text}; subtract it from its column")


def _hums(channel: Channel, record: Record) -> Finding | None:
    acting = channels(record, (FORCE, GROUND, *SUPPORT), excused=[channel.name])
    steady = hum(channel.measured, record.step, [input_channel.measured for input_channel in acting])
    if steady is None:
        return None
    line, share = steady
    where = of_mains(line, record.step)
    text = f"the {channel.name} hums: {100 * share:.0f} % of its power is a steady line at {where}"
    return Finding("hum", channel.name, f"{text}, which nothing that acts has; filter it out, or leave that sensor out")


def first_sample_findings(record: Record, estimate: Estimate) -> list[Finding]:
    """First samples that are far off: a filter that settles, a sensor that is switched on.

    What is left of a good record is left everywhere. There, the estimate follows a few wrong samples or leaves them:
    the sensor is told that is furthest off. Where none is, the model may leave out a force.
    """
    count, misfit = max(3, math.ceil(BEGINNING * len(record.time))), estimate.misfit
    worst, fault, residual = 0.0, "", np.zeros(0)
    for channel in channels(record, (*RESPONSE_QUANTITIES, FORCE, GROUND, *SUPPORT)):
        estimated = channel.of(estimate.response)
        gap = ~(np.isfinite(estimated) & channel.there)
        off = np.where(gap, 0.0, channel.measured - estimated)
        far = _far_off(off, np.where(gap, 0.0, channel.measured), channel.of(estimate.std), count)
        if far > worst:
            worst, residual, at = far, off, int(np.argmax(np.abs(off[:count])))
            numbers = f"was measured as {channel.measured[at]:.3g} and estimated as {estimated[at]:.3g}"
            fault = f"the {channel.name} {numbers} at {record.time[at]:.4g} s"
    if not fault and misfit is not None and len(misfit.history) == len(record.time) and misfit.acting > 0.0:
        force, ones = np.linalg.norm(misfit.history.astype(float), axis=1), np.ones(len(record.time))
        if _far_off(force, misfit.acting * ones, misfit.rest * ones, count):
            residual, at = force, int(np.argmax(force[:count]))
            fault = f"the model leaves out a force of {force[at]:.3g} N at {record.time[at]:.4g} s"
    if not fault:
        return []
    last = int(np.flatnonzero(np.abs(residual[:count]) > ABOVE_REST * np.std(residual[count:])).max(initial=0))
    text = f"the first {last + 1} samples are far off: {fault}; leave them out (data.start={record.time[last + 1]:.4g})"
    return [Finding("first_samples", "record", text)]


def _far_off(residual: np.ndarray, signal: np.ndarray, std: np.ndarray, count: int) -> float:
    """What is left of the first samples, over the signal; 0 where it is no more than the rest, or ``std``, allows.

    Args:
        residual: (N,), of every sample.
        signal: (N,).
        std: (N,), of what was estimated; NaN where it is unknown.
        count: Of the first samples.
    """
    parts = residual[:count], residual[count:], signal[:count], np.nan_to_num(std[:count])
    first, rest, begins, deviation = map(_rms, parts)
    size = max(float(np.std(signal)), begins)
    allowed = max(FAR_OFF * size, ABOVE_REST * rest, ABOVE_REST * deviation)
    return first / size if first > allowed > 0.0 else 0.0


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))
