"""A time axis in another unit than seconds, by the natural frequencies that the chain should have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.verdict.channel_faults import REPRODUCED
from pinn_cli.verdict.comparison import comparisons
from pinn_cli.verdict.finding import Finding
from pinn_cli.verdict.modes import Modes
from pinn_cli.verdict.prediction import LINEAR, predicted

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.system.chain import Chain

# Seconds that the unit of the time axis may be long.
UNITS = {1e-3: "milliseconds", 1e-6: "microseconds", 1e3: "thousands of seconds", 60.0: "minutes", 1 / 60: "1/60 s"}
# A highest natural frequency up to this times the Nyquist frequency may be seen in the record.
SEEN = 1.3


def time_unit_fault(chain: Chain, record: Record, excused: Sequence[str] = ()) -> Finding | None:
    """The unit of time in which the chain predicts every sensor; None where seconds will do, or no unit does.

    Args:
        chain: Whose natural frequencies should be in the record's band, below its Nyquist frequency.
        record: With its time as given.
        excused: Names of channels that have a fault of their own.
    """
    if not np.isfinite(record.force).all() or in_band(chain, record):
        return None
    for seconds in UNITS:
        scaled = replace(record, time=record.time * seconds)
        if not in_band(chain, scaled) or (prediction := predicted(chain, scaled)) is None:
            continue
        misfits = [c.misfit for c in comparisons(prediction) if c.channel.name not in excused]
        if misfits and max(misfits) <= REPRODUCED:
            return unit_finding(seconds, max(misfits))
    return None


def unit_finding(seconds: float, left: float) -> Finding:
    """That the unit of the time axis is so many seconds long."""
    reason = f"the chain does what was measured if the time is in {UNITS[seconds]}"
    return Finding("time_unit", "time", f"{reason}; multiply the time column by {seconds:.6g}", "failed", left)


def in_band(chain: Chain, record: Record) -> bool:
    """Whether the record is sampled fast enough for the chain, and long enough for a period of its first mode."""
    own = chain.parameters_like(np.empty(0))
    frequencies = Modes.of({name: own[name] for name in LINEAR}).natural_frequencies
    if not np.isfinite(frequencies).all():
        return False
    return bool(frequencies[-1] < SEEN * 0.5 / record.step and frequencies[0] > 1.0 / record.duration)
