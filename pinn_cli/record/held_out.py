"""Response sensors of DOFs that are held out: no estimator sees them, they score it. Forces are inputs, and stay."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pinn_cli.record.gauge import Gauge
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.settings.errors import InputError

# Part of a step by which a sample may be off the time where it scores.
OFF = 0.05


def not_held_out(gauges: Sequence[Gauge], holdout: Sequence[int]) -> tuple[Gauge, ...]:
    """The gauges that an estimator may see.

    Args:
        gauges: Of the record.
        holdout: DOFs, counted from 1.

    Raises:
        InputError: One that feels a DOF which is held out, and another one too.
    """
    dofs = {dof - 1 for dof in holdout}
    held = [gauge for gauge in gauges if gauge.quantity in RESPONSE_QUANTITIES and dofs & set(gauge.weights)]
    for gauge in held:
        if not gauge.feels_one:
            allowed = "DOFs whose every channel measures that DOF alone"
            raise InputError("data.holdout", list(holdout), allowed, f"channel {gauge.name} feels others too")
    return tuple(gauge for gauge in gauges if gauge not in held)


def scored_by(gauge: Gauge, time: np.ndarray, holdout: Sequence[int]) -> np.ndarray:
    """What a sensor that is held out knows of the truth (N,), NaN where it has no sample.

    Args:
        gauge: Of a DOF that is held out.
        time: (N,), s, of the record.
        holdout: DOFs, counted from 1.

    Raises:
        InputError: One whose calibration nobody knows, or that has no samples at the record's times.
    """
    at, felt = gauge.calibrated()
    step = (time[-1] - time[0]) / (len(time) - 1)
    place = np.rint((at - time[0]) / step).astype(np.int64)
    known = all(gauge.of(kind).is_known for kind in gauge.calibration)
    if not known or gauge.of("delay").value or np.abs(at - time[0] - place * step).max() > OFF * step:
        allowed = "DOFs whose channels have a known calibration, no delay, and samples at even times"
        raise InputError("data.holdout", list(holdout), allowed, f"nothing else scores channel {gauge.name}")
    truth = np.full(len(time), np.nan)
    truth[place] = felt
    return truth
