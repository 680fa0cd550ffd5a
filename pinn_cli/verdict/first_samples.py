"""A record whose first samples are far off: a filter that settles, a sensor that is switched on.

What is left of a good record is left everywhere. There, the estimate follows a few wrong samples or leaves them, and
where it leaves nothing of any sensor the model leaves out a force.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.channels import channels
from pinn_cli.record.response import GROUND, RESPONSE_QUANTITIES
from pinn_cli.system.quantities import FORCE, SUPPORT
from pinn_cli.verdict.finding import Finding

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.training.estimate import Estimate

# The beginning of a record, as a share of it. It is far off where what is left there is so large a part of the signal,
# and so many times what is left of the rest.
BEGINNING, FAR_OFF, ABOVE_REST = 0.02, 0.5, 5.0


def first_sample_findings(record: Record, estimate: Estimate) -> list[Finding]:
    """Of the sensor that is furthest off; else of the force that the model leaves out."""
    count, misfit = max(3, math.ceil(BEGINNING * len(record.time))), estimate.misfit
    worst, told, left = 0.0, "", np.zeros(0)
    for channel in channels(record, (*RESPONSE_QUANTITIES, FORCE, GROUND, *SUPPORT)):
        found = channel.of(estimate.response)
        gap = ~np.isfinite(found) if channel.there is None else ~channel.there
        off = np.where(gap, 0.0, channel.measured - found)
        far = _far_off(off, np.where(gap, 0.0, channel.measured), channel.of(estimate.std), count)
        if far > worst:
            worst, left, at = far, off, int(np.argmax(np.abs(off[:count])))
            numbers = f"was measured as {channel.measured[at]:.3g} and estimated as {found[at]:.3g}"
            told = f"the {channel.name} {numbers} at {record.time[at]:.4g} s"
    if not told and misfit is not None and len(misfit.history) == len(record.time) and misfit.acting > 0.0:
        force, every = np.linalg.norm(misfit.history.astype(float), axis=1), np.ones(len(record.time))
        if _far_off(force, misfit.acting * every, misfit.rest * every, count):
            left, at = force, int(np.argmax(force[:count]))
            told = f"the model leaves out a force of {force[at]:.3g} N at {record.time[at]:.4g} s"
    if not told:
        return []
    last = int(np.flatnonzero(np.abs(left[:count]) > ABOVE_REST * np.std(left[count:])).max(initial=0))
    text = f"the first {last + 1} samples are far off: {told}; leave them out (data.start={record.time[last + 1]:.4g})"
    return [Finding("first_samples", "record", text)]


def _far_off(left: np.ndarray, signal: np.ndarray, std: np.ndarray, count: int) -> float:
    """What is left of the first samples, over the signal; 0 where it is no more than the rest, or ``std``, allows.

    Args:
        left: (N,), of every sample.
        signal: (N,).
        std: (N,), of what was estimated; NaN where it is unknown.
        count: Of the first samples.
    """
    parts = left[:count], left[count:], signal[:count], np.nan_to_num(std[:count])
    first, rest, begins, known = map(_rms, parts)
    size = max(float(np.std(signal)), begins)
    allowed = max(FAR_OFF * size, ABOVE_REST * rest, ABOVE_REST * known)
    return first / size if first > allowed > 0.0 else 0.0


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))
