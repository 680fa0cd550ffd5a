"""What is wrong with one channel, or the force, where others call the structure right; first samples that are far off.

What a channel shows by itself is taken over from the checks of a record.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.channel import Channel
from pinn_cli.record.channels import channels
from pinn_cli.record.checks import DEVIATIONS, LEAST_OFFSET, CheckedRecord, told_offset
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.record.signal import Sampling, Signal
from pinn_cli.system.left_out import rms
from pinn_cli.system.quantities import FORCE, GROUND, SUPPORT
from pinn_cli.verdict.finding import Finding, failed_if
from pinn_cli.verdict.prediction import Comparison, compare, comparisons

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.training.estimate import Estimate
    from pinn_cli.verdict.prediction import Prediction

# NMSE up to which a channel counts as predicted. Sensors with 10 dB of noise are at 0.1 with a right chain; a lightly
# damped chain whose stiffnesses are 2 % off is above 0.5.
REPRODUCED = 0.2
# Readings of 60 random rigs without a fault: factors within 4 % (force with 21 dB of noise), delays within 0.1 sample,
# offsets within 1.2 % of the channel's rms; up to 7, 10 and 3 standard deviations from what is right.
LEAST_GAIN_FAULT, LEAST_DELAY_FAULT = 0.06, 0.3
# A cause must bring the channel's NMSE down to this share of what it was: a law that is left out turns phases, as a
# delay does, and leaves more than that.
MENDS = 0.5
# A change of sensors is a claim about two channels at once and must mend more.
MENDS_BY_MOVING = 0.3
# Two factors or delays are the same within this share.
SAME_FACTOR = 0.03
# Off by no more than this share, a factor is that of a unit.
UNIT_WITHIN = 0.03

_UNIT_FACTORS = {
    9.80665: ("9.80665", "g and m/s^2, or kgf and N"),
    1e1: ("10", "a decade"),
    1e2: ("100", "cm and m"),
    1e3: ("1000", "mm and m, or kN and N"),
    1e6: ("1e6", "um and m, or MN and N"),
    25.4: ("25.4", "inches and mm"),
    1 / 0.0254: ("1/0.0254", "inches and m"),
    1 / 0.3048: ("1/0.3048", "feet and m"),
    4.4482216: ("4.448", "pounds-force and N"),
    2 * math.pi: ("2 pi", "Hz and rad/s"),
}

# The beginning of a record, as a share of it. It is far off where what is left there is so large a part of the signal,
# and so many times what is left of the rest.
BEGINNING, FAR_OFF, ABOVE_REST = 0.02, 0.5, 5.0


def channel_faults(prediction: Prediction, excused: Sequence[str] = ()) -> list[Finding]:
    """The one channel, pair of channels or force whose mending makes the structure predict every sensor; else nothing.

    The prediction is of a structure that may be right. Channels whose fault is known already are ``excused``, by name.
    """
    compared = comparisons(prediction, excused)
    explanations = {c.channel.name: explained(c) for c in compared}
    faulty = [c for c in compared if explanations[c.channel.name] is not None or c.misfit > REPRODUCED]
    if not faulty:
        return []
    if len(faulty) == len(compared):
        common = _common_fault(compared)
        if common is not None:
            return [common]
    moved = _exchanged(faulty, prediction) or _misplaced(faulty, prediction)
    mended = [finding for c in faulty if (finding := explanations[c.channel.name]) is not None]
    complete = len(mended) == len(faulty) and max(finding.misfit for finding in mended) <= REPRODUCED
    if moved is not None and (not complete or moved.misfit < max(finding.misfit for finding in mended)):
        return [moved]
    if complete and (len(mended) == 1 or len(mended) < len(compared)):
        if len(compared) == 1 and mended[0].kind != "offset":
            return [replace(mended[0], text=f"{mended[0].text}; with one sensor, the force may be what is off")]
        return mended
    if mended or len(faulty) != 1 or len(compared) < 3:
        return []
    # A structure that predicts at least two others does not predict this one.
    name = faulty[0].channel.name
    reason = f"the {name} alone is not what the structure does under the measured {faulty[0].acting}"
    return [Finding("sensor", name, f"{reason}; check that sensor, or leave it out", misfit=faulty[0].misfit)]


def explained(comparison: Comparison) -> Finding | None:
    """The fault of one channel that mends it best; None where it has none, or none that mends it."""
    best = min(_faults_of(comparison), key=lambda finding: finding.misfit, default=None)
    if best is None or best.misfit > REPRODUCED or best.misfit > MENDS * comparison.misfit:
        return None
    return best


def _faults_of(c: Comparison) -> Iterator[Finding]:
    """A factor, a delay and an offset, as far as there are any."""
    if _off(c):
        moves, name = f"what the structure does under the measured {c.acting}", c.channel.name
        finding = factor_finding(name, c.channel.setting, c.factor.value, moves, c.factor.std)
        yield replace(finding, misfit=c.factor.misfit)
    if _is_late(c):
        yield replace(late_finding(c.channel, c.delay.value, c.record.step), misfit=c.delay.misfit)
    rms = float(np.sqrt(c.power))
    if c.offset.differs(0.0, LEAST_OFFSET * rms, DEVIATIONS):
        yield replace(_offset_finding(c.channel, c.offset.value, rms), misfit=c.offset.misfit)


def _offset_finding(channel: Channel, offset: float, rms: float) -> Finding:
    text = f"the {channel.name} {told_offset(offset, rms)}; subtract it from its column"
    return Finding("offset", channel.name, text)


def factor_finding(name: str, setting: str, value: float, of: str, std: float = 0.0, source: str = "") -> Finding:
    """That something is so many times what it should be, known to within ``std``; ``source`` says so."""
    times = f"{value:.4g} times"
    if unit := unit_of(value, std):
        kind, times, remedy = "unit", f"{times} ({unit})", f"check the unit of {setting}"
    elif value < 0:
        kind, remedy = "sign", f"check the direction of {setting}, and multiply it by -1"
        times = "the negative of" if abs(value + 1) < 2 * LEAST_GAIN_FAULT else times
    else:
        kind, remedy = "gain", f"check the calibration of {setting}, or divide it by {value:.4g}"
    return Finding(kind, name, f"{source}the {name} is {times} {of}; {remedy}")


def _is_late(c: Comparison) -> bool:
    return c.delay.differs(0.0, LEAST_DELAY_FAULT * c.record.step, DEVIATIONS)


def _off(c: Comparison) -> bool:
    """Whether a factor differs from one, wherever between its two readings it lies."""
    low, high = sorted((c.factor.value, c.reverse_factor))
    outside = low > 1 + LEAST_GAIN_FAULT or high < 1 / (1 + LEAST_GAIN_FAULT)
    return outside and c.factor.differs(1.0, 0.0, DEVIATIONS)


def late_finding(channel: Channel, delay: float, step: float) -> Finding:
    """That a channel is late, or early, by s; of samples that are a step apart."""
    later = "late" if delay > 0 else "early"
    reason = f"the {channel.name} is {abs(delay):.4g} s ({abs(delay) / step:.2f} samples) {later}"
    return Finding("delay", channel.name, f"{reason}; shift its column in time")


def _common_fault(compared: Sequence[Comparison]) -> Finding | None:
    """What all of several channels share: then the force is to blame, or the ground's sensor, whichever there is."""
    factors, delays = [c.factor for c in compared], [c.delay for c in compared]
    record, forced = compared[0].record, compared[0].forced
    shaken = record.ground_acceleration is not None
    if len(compared) == 1 or bool(forced) == shaken:
        return None
    name, setting = "ground acceleration", f"data.{GROUND}"
    if not shaken:
        name, setting = f"force of DOF {', '.join(forced)}", "data.force"
    value, late = (float(np.median([reading.value for reading in of])) for of in (factors, delays))
    if all(_off(c) for c in compared) and all(abs(f.value / value - 1) < SAME_FACTOR for f in factors):
        readings, source = factors, "every sensor says that "
        finding = factor_finding(name, setting, 1 / value, "what acts", factors[0].std, source)
    elif all(_is_late(c) and abs(c.delay.value - late) < 0.2 * record.step for c in compared):
        readings, when = delays, f"{abs(late):.4g} s {'early' if late > 0 else 'late'}"
        finding = Finding("delay", name, f"every sensor says that the {name} is {when}; shift its column in time")
    else:
        return None
    misfit = max(reading.misfit for reading in readings)
    return replace(finding, misfit=misfit) if misfit <= REPRODUCED else None


def _exchanged(faulty: Sequence[Comparison], prediction: Prediction) -> Finding | None:
    """Two sensors of one kind that fit each other's place."""
    if len(faulty) != 2 or faulty[0].channel.quantity != faulty[1].channel.quantity:
        return None
    first, second = faulty
    pairs = (first.channel, second.channel), (second.channel, first.channel)
    misfit = max(compare(one, prediction, other.dof).misfit for one, other in pairs)
    if misfit > REPRODUCED or misfit > MENDS_BY_MOVING * max(first.misfit, second.misfit):
        return None
    return replace(swap_finding(first.channel, second.channel), misfit=misfit)


def swap_finding(first: Channel, second: Channel) -> Finding:
    """That two channels are in each other's place."""
    name = f"{first.quantity} of DOFs {first.where} and {second.where}"
    return Finding("swap", name, f"the {name} fit each other's place; swap their columns")


def _misplaced(faulty: Sequence[Comparison], prediction: Prediction) -> Finding | None:
    """One sensor that fits another DOF."""
    if len(faulty) != 1:
        return None
    (comparison,) = faulty
    dofs = [dof for dof in range(prediction.record.ndof) if dof != comparison.channel.dof]
    tried = [(compare(comparison.channel, prediction, dof).misfit, dof) for dof in dofs]
    misfit, dof = min(tried, default=(np.inf, 0))
    if misfit > REPRODUCED or misfit > MENDS_BY_MOVING * comparison.misfit:
        return None
    return replace(misplaced_finding(comparison.channel, prediction.record.dof_name(dof)), misfit=misfit)


def misplaced_finding(channel: Channel, dof: str) -> Finding:
    """That a channel is on another DOF than it is said to be."""
    check = "check where it acts" if channel.quantity == FORCE else "check where that sensor is mounted"
    return Finding("misplaced", channel.name, f"the {channel.name} fits DOF {dof}; {check}")


def unit_of(factor: float, std: float = 0.0) -> str:
    """The factor and which two units were taken for each other: ``1/9.80665: g and m/s^2``; "" where no unit fits.

    The factor is measured over expected, and known to within ``std``.
    """
    size, sign = abs(factor), "-" if factor < 0 else ""
    allowed = min(UNIT_WITHIN, max(0.01, 4.0 * std / size)) if size else 0.0
    for exact, (written, units) in _UNIT_FACTORS.items():
        if abs(size / exact - 1) < allowed:
            return f"{sign}{written}: {units}"
        if abs(size * exact - 1) < allowed:
            inverse = written[2:] if written.startswith("1/") else f"1/{written}"
            return f"{sign}{inverse}: {units}"
    return ""


def record_faults(record: Record, carried: Sequence[int] = ()) -> list[Finding]:
    """What sensors show by themselves (:mod:`pinn_cli.record.checks`), of each the gravest; forces may do anything.

    Args:
        record: Whose channels they are.
        carried: DOFs that nothing holds: they may move on and on.
    """
    every = channels(record, (*RESPONSE_QUANTITIES, FORCE, GROUND, *SUPPORT))
    signals = [Signal(channel.name, channel.measured, channel.quantity, channel.where) for channel in every]
    checked = CheckedRecord(signals, Sampling(record.time))
    findings = []
    for i, channel in enumerate(every):
        told = (fault for fault in checked.faults_of(i) if fault.kind != "offset" or channel.dof not in carried)
        if channel.quantity != FORCE and (fault := next(told, None)):
            findings.append(Finding(fault.kind, channel.name, fault.text, failed_if(fault.kind == "still")))
    return findings


def first_sample_findings(record: Record, estimate: Estimate) -> list[Finding]:
    """First samples that are far off: a filter that settles, a sensor that is switched on.

    What is left of a good record is left everywhere. There, the estimate follows a few wrong samples or leaves them:
    the sensor is told that is furthest off. Where none is, the model may leave out a force. Of one that does not hold
    without those samples either, the beginning says nothing.
    """
    count, misfit = max(3, math.ceil(BEGINNING * len(record.time))), estimate.misfit
    worst, fault, residual, is_followed = 0.0, "", np.zeros(0), False
    for channel in channels(record, (*RESPONSE_QUANTITIES, FORCE, GROUND, *SUPPORT)):
        estimated = channel.of(estimate.response)
        gap = ~(np.isfinite(estimated) & channel.there)
        off = np.where(gap, 0.0, channel.measured - estimated)
        measured = np.where(gap, 0.0, channel.measured)
        far = _far_off(off, measured, channel.of(estimate.std), count)
        is_followed |= channel.quantity in RESPONSE_QUANTITIES and rms(off[count:]) < FAR_OFF * rms(measured[count:])
        if far > worst:
            worst, residual, at = far, off, int(np.argmax(np.abs(off[:count])))
            numbers = f"was measured as {channel.measured[at]:.3g} and estimated as {estimated[at]:.3g}"
            fault = f"the {channel.name} {numbers} at {record.time[at]:.4g} s"
    if not fault and is_followed and misfit is not None and len(misfit.history) == len(record.time):
        force, ones = np.linalg.norm(misfit.history.astype(float), axis=1), np.ones(len(record.time))
        holds = rms(force[count:]) < FAR_OFF * misfit.acting
        if holds and _far_off(force, misfit.acting * ones, misfit.rest * ones, count):
            residual, at = force, int(np.argmax(force[:count]))
            fault = f"the model leaves out a force of {force[at]:.3g} N at {record.time[at]:.4g} s"
    if not fault:
        return []
    last = int(np.flatnonzero(np.abs(residual[:count]) > ABOVE_REST * np.std(residual[count:])).max(initial=0))
    text = f"the first {last + 1} samples are far off: {fault}; leave them out (data.start={record.time[last + 1]:.4g})"
    return [Finding("first_samples", "record", text)]


def _far_off(residual: np.ndarray, signal: np.ndarray, std: np.ndarray, count: int) -> float:
    """What is left of the first samples, over the signal; 0 where it is no more than the rest, or ``std``, allows.

    All are (N,); ``std`` is that of what was estimated, NaN where it is unknown.
    """
    parts = residual[:count], residual[count:], signal[:count], np.nan_to_num(std[:count])
    first, rest, begins, deviation = map(rms, parts)
    size = max(float(np.std(signal)), begins)
    allowed = max(FAR_OFF * size, ABOVE_REST * rest, ABOVE_REST * deviation)
    return first / size if first > allowed > 0.0 else 0.0
