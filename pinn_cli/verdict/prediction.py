"""What a structure does under the measured force and the ground's motion alone: no response sensor is looked at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import irfft, rfft
from scipy.interpolate import make_interp_spline

from pinn_cli.record.simulation import OverflowsError, simulate
from pinn_cli.record.steps import substeps_needed
from pinn_cli.system.modes import Modes, modes_of
from pinn_cli.system.support import loose_dofs
from pinn_cli.verdict.linear_response import linear_response

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.record.record import Record
    from pinn_cli.record.response import Response
    from pinn_cli.record.runge_kutta import Force
    from pinn_cli.system.structure import Structure

# Steps of Runge-Kutta, 45 us each: a nonlinear chain is followed for the first part of a longer record only.
MOST_STEPS = 40_000
# A spline through samples this many times as dense follows a history up to the Nyquist frequency to 1e-3.
DENSER, SPLINE_DEGREE = 4, 5
LINEAR = ("m", "c", "k")


@dataclass(frozen=True, eq=False)
class Prediction:
    """A response to the measured force, and the part of the record that it is of.

    Attributes:
        response: (M, n) each, up to free decays.
        record: Its first M samples.
        modes: Of the structure without its nonlinearity, whose free decays count as part of the prediction.
    """

    response: Response
    record: Record
    modes: Modes


def predicted(structure: Structure, record: Record, start: Sequence[np.ndarray] | None = None) -> Prediction | None:
    """The response of a structure to the record's force; None where a force is unknown or the structure is unstable.

    Args:
        structure: Any. A linear one is solved in the frequency domain, exactly and in milliseconds; another one is
            simulated from ``start`` on.
        record: For its force and its times.
        start: Displacement and velocity (n,) at the first sample; None: rest. Of a linear chain it does not matter.
    """
    if not np.isfinite(record.force).all():
        return None
    parameters = structure.parameters_like(np.empty(0))
    if not all(np.isfinite(value).all() for value in parameters.values()) or (parameters["m"] <= 0).any():
        return None
    modes = modes_of(structure)
    # A body that nothing holds has no response that repeats itself: it is simulated.
    if is_linear(structure) and not loose_dofs(structure):
        response = linear_response(modes, record)
        finite = np.isfinite(response.displacement).all() and modes.stable
        return Prediction(response, record, modes) if finite else None
    substeps = substeps_needed(structure, record.step)
    samples = min(len(record.time), MOST_STEPS // substeps)
    if samples < len(modes.poles) * 8:
        return None
    part = record.until(samples)
    hold = "zero_order" if record.intersample == "zero_order_hold" else "exact"
    ground = None if record.ground_acceleration is None else between_samples(record, record.ground_acceleration)
    force = force_between_samples(record, hold)
    try:
        response = simulate(
            structure, force, part.time, hold, substeps=substeps, initial=start, ground=ground, frame=record.frame
        )
    except OverflowsError:
        return None
    return Prediction(response, part, modes)


def is_linear(structure: Structure) -> bool:
    """Whether every nonlinear parameter of a structure is zero."""
    return not any(bool(value.any()) for name, value in structure.parameters.items() if name not in LINEAR)


def force_between_samples(record: Record, hold: str) -> Force:
    """The force at any time of the record, see :func:`between_samples`."""
    if hold == "zero_order":
        return lambda time: record.force[: len(time)]
    return between_samples(record, record.force)


def between_samples(record: Record, values: np.ndarray) -> Force:
    """A band-limited history at any time of the record, from its samples (N, ...).

    Between samples taken barely fast enough a spline loses a good part of it, so it goes through the samples of
    the same sinusoids taken `DENSER` times as often. The record is mirrored at its end to make it periodic.
    """
    mirrored = np.concatenate((values, values[-2:0:-1]))
    spectrum, count = rfft(mirrored, axis=0), len(mirrored)
    spectrum[-1] *= 0.5  # the Nyquist line of an even number of samples stands for two once there are more samples
    dense = DENSER * irfft(spectrum, DENSER * count, axis=0)[: DENSER * (len(record.time) - 1) + 1]
    spline: Force = make_interp_spline(np.linspace(record.time[0], record.time[-1], len(dense)), dense, k=SPLINE_DEGREE)
    return spline
