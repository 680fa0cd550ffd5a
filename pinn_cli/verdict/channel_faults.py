"""What is wrong with a sensor, the ground's too, or with the force, where other channels call the structure right."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.system.quantities import FORCE, GROUND
from pinn_cli.verdict.finding import Finding
from pinn_cli.verdict.prediction import Comparison, compare, comparisons
from pinn_cli.verdict.record_faults import DEVIATIONS, LEAST_OFFSET

if TYPE_CHECKING:
    from pinn_cli.record.channel import Channel
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


def channel_faults(prediction: Prediction, excused: Sequence[str] = ()) -> list[Finding]:
    """The one channel, pair of channels or force whose mending makes the structure predict every sensor; else nothing.

    Args:
        prediction: Of a structure that may be right.
        excused: Names of channels whose fault is known already, which are not compared.
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
        return mended if len(compared) > 1 else [_or_force(mended[0])]
    return _odd_one_out(faulty, compared) if not mended else []


def _or_force(finding: Finding) -> Finding:
    """One sensor alone cannot say which of the two is off."""
    if finding.kind == "offset":
        return finding
    return replace(finding, text=f"{finding.text}; with one sensor, the force may be what is off")


def explained(comparison: Comparison) -> Finding | None:
    """The fault of one channel that mends it best; None where it has none, or none that mends it."""
    faults = [f for f in (_factor(comparison), _delay(comparison), _offset(comparison)) if f is not None]
    best = min(faults, key=lambda finding: finding.misfit, default=None)
    if best is None or best.misfit > REPRODUCED or best.misfit > MENDS * comparison.misfit:
        return None
    return best


def _factor(c: Comparison) -> Finding | None:
    if not _off(c):
        return None
    moves = f"what the structure does under the measured {c.acting}"
    finding = factor_finding(c.channel, c.factor.value, moves, c.factor.std)
    return replace(finding, misfit=c.factor.misfit)


def factor_finding(channel: Channel, value: float, of: str, std: float = 0.0) -> Finding:
    """That a channel is so many times what it should be."""
    kind, text = _factor_in_words(value, std)
    remedy = _remedy(kind, channel.setting, value)
    return Finding(kind, channel.name, f"the {channel.name} is {text} {of}; {remedy}")


def _off(c: Comparison) -> bool:
    """Whether a factor differs from one, wherever between its two readings it lies."""
    low, high = sorted((c.factor.value, c.reverse_factor))
    outside = low > 1 + LEAST_GAIN_FAULT or high < 1 / (1 + LEAST_GAIN_FAULT)
    return outside and c.factor.differs(1.0, 0.0, DEVIATIONS)


def _factor_in_words(value: float, std: float) -> tuple[str, str]:
    """The kind of a factor, and the words for it."""
    unit = unit_of(value, std)
    if unit:
        return "unit", f"{value:.4g} times ({unit})"
    if value < 0:
        return "sign", "the negative of" if abs(value + 1) < 2 * LEAST_GAIN_FAULT else f"{value:.4g} times"
    return "gain", f"{value:.4g} times"


def _remedy(kind: str, setting: str, value: float) -> str:
    if kind == "unit":
        return f"check the unit of {setting}"
    if kind == "sign":
        return f"check the direction of {setting}, and multiply it by -1"
    return f"check the calibration of {setting}, or divide it by {value:.4g}"


def _delay(c: Comparison) -> Finding | None:
    if not c.delay.differs(0.0, LEAST_DELAY_FAULT * c.record.step, DEVIATIONS):
        return None
    return replace(late_finding(c.channel, c.delay.value, c.record.step), misfit=c.delay.misfit)


def late_finding(channel: Channel, delay: float, step: float) -> Finding:
    """That a channel is late, or early, by s; of samples that are a step apart."""
    later = "late" if delay > 0 else "early"
    reason = f"the {channel.name} is {abs(delay):.4g} s ({abs(delay) / step:.2f} samples) {later}"
    return Finding("delay", channel.name, f"{reason}; shift its column in time")


def _offset(c: Comparison) -> Finding | None:
    rms = float(np.sqrt(c.power))
    if not c.offset.differs(0.0, LEAST_OFFSET * rms, DEVIATIONS):
        return None
    share, name = 100 * abs(c.offset.value) / rms, c.channel.name
    reason = f"the {name} has an offset of {c.offset.value:.4g} ({share:.0f} % of its rms)"
    return Finding("offset", name, f"{reason}; subtract it from its column", misfit=c.offset.misfit)


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
    value = float(np.median([f.value for f in factors]))
    if all(_off(c) for c in compared) and all(abs(f.value / value - 1) < SAME_FACTOR for f in factors):
        misfit = max(f.misfit for f in factors)
        kind, text = _factor_in_words(1 / value, factors[0].std)
        reason = f"every sensor says that the {name} is {text} what acts"
        remedy = _remedy(kind, setting, 1 / value)
        return Finding(kind, name, f"{reason}; {remedy}", misfit=misfit) if misfit <= REPRODUCED else None
    late = float(np.median([d.value for d in delays]))
    shifted = all(d.differs(0.0, LEAST_DELAY_FAULT * record.step, DEVIATIONS) for d in delays)
    if shifted and all(abs(d.value - late) < 0.2 * record.step for d in delays):
        misfit = max(d.misfit for d in delays)
        reason = f"every sensor says that the {name} is {abs(late):.4g} s {'early' if late > 0 else 'late'}"
        return (
            Finding("delay", name, f"{reason}; shift its column in time", misfit=misfit)
            if misfit <= REPRODUCED
            else None
        )
    return None


def _exchanged(faulty: Sequence[Comparison], prediction: Prediction) -> Finding | None:
    """Two sensors of one kind that fit each other's place."""
    if len(faulty) != 2 or faulty[0].channel.quantity != faulty[1].channel.quantity:
        return None
    first, second = faulty
    after = [
        compare(first.channel, prediction, second.channel.dof),
        compare(second.channel, prediction, first.channel.dof),
    ]
    misfit = max(c.misfit for c in after)
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


def _odd_one_out(faulty: Sequence[Comparison], compared: Sequence[Comparison]) -> list[Finding]:
    """The one sensor that is not predicted by a structure that predicts at least two others."""
    if len(faulty) != 1 or len(compared) < 3:
        return []
    name = faulty[0].channel.name
    reason = f"the {name} alone is not what the structure does under the measured {faulty[0].acting}"
    return [Finding("sensor", name, f"{reason}; check that sensor, or leave it out", misfit=faulty[0].misfit)]


def unit_of(factor: float, std: float = 0.0) -> str:
    """The factor and which two units were taken for each other: ``1/9.80665: g and m/s^2``; "" where no unit fits.

    Args:
        factor: Measured over expected.
        std: Its standard deviation.
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
