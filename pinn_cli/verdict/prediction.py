"""What a structure does under the measured force and the ground's motion alone: no response sensor is looked at."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import irfft, rfft
from scipy.interpolate import make_interp_spline

from pinn_cli.record.resimulation import support_motion
from pinn_cli.record.simulation import OverflowsError, simulate
from pinn_cli.record.steps import TooStiffError, method_needed, with_slow_followers
from pinn_cli.system.modes import Modes, modes_of
from pinn_cli.system.support import loose_dofs
from pinn_cli.verdict.linear_response import decays, felt_modes, linear_response

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.record.channels import Channel
    from pinn_cli.record.record import Record
    from pinn_cli.record.response import Response
    from pinn_cli.record.runge_kutta import Force
    from pinn_cli.system.structure import Structure

# Steps of Runge-Kutta, 45 us each: a nonlinear chain is followed for the first part of a longer record only.
MOST_STEPS = 40_000
# Steps of Runge-Kutta that take as long as the implicit steps of a sample.
OF_IMPLICIT = 10
# A spline through samples this many times as dense follows a history up to the Nyquist frequency to 1e-3.
DENSER, SPLINE_DEGREE = 4, 5
# Dense samples behind a part of a history that its spline goes through as well: none further on reaches into the part
# (each counts 0.43 times as much as the one before it).
BEYOND_PART = 64
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
    _decays: dict[tuple[int, ...], np.ndarray] = field(default_factory=dict)

    def decays(self, channel: Channel) -> np.ndarray:
        """See :func:`pinn_cli.verdict.linear_response.decays`; channels that feel the same modes share theirs."""
        seen = felt_modes(self.modes, channel)
        if seen not in self._decays:
            self._decays[seen] = decays(self.modes, seen, self.record)
        return self._decays[seen]


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
    structure = with_slow_followers(structure, record.step)
    method, substeps = method_needed(structure, record.step)
    samples = min(len(record.time), MOST_STEPS // (substeps if method == "rk4" else OF_IMPLICIT))
    if samples < len(modes.poles) * 8:
        return None
    part = record.until(samples)
    hold = "zero_order" if record.intersample == "zero_order_hold" else "exact"
    moved = record.ground_acceleration
    ground = None if moved is None else between_samples(record, moved, samples)
    force = force_between_samples(record, hold, samples)
    try:
        response = simulate(
            structure, force, part.time, hold, method, substeps, initial=start, ground=ground,
            supports=support_motion(record), frame=record.frame,
        )  # fmt: skip
    except (OverflowsError, TooStiffError):
        return None
    return Prediction(response, part, modes)


def is_linear(structure: Structure) -> bool:
    """Whether every nonlinear parameter of a structure is zero."""
    return not any(bool(value.any()) for name, value in structure.parameters.items() if name not in LINEAR)


def force_between_samples(record: Record, hold: str, samples: int | None = None) -> Force:
    """The force at any time of the record, see :func:`between_samples`."""
    if hold == "zero_order":
        return lambda time: record.force[: len(time)]
    return between_samples(record, record.force, samples)


def between_samples(record: Record, values: np.ndarray, samples: int | None = None) -> Force:
    """A band-limited history at any time of the record, from its samples (N,) or (N, n).

    Between samples taken barely fast enough a spline loses a good part of it, so it goes through the samples of
    the same sinusoids taken `DENSER` times as often. The record is mirrored at its end to make it periodic.

    Args:
        record: For its times.
        values: Of a force most columns are zero as a rule, and stay so.
        samples: The first ones, up to which alone the history is asked for; None: all.
    """
    columns = values.reshape(len(values), -1)
    acting = np.flatnonzero(columns.any(axis=0))
    last = len(record.time) - 1
    end = DENSER * last if samples is None else min(DENSER * last, DENSER * (samples - 1) + BEYOND_PART)
    times = np.linspace(record.time[0], record.time[-1], DENSER * last + 1)[: end + 1]
    splines = [make_interp_spline(times, _denser(columns[:, i])[: end + 1], k=SPLINE_DEGREE) for i in acting]

    def history(time: np.ndarray) -> np.ndarray:
        out = np.zeros((*np.shape(time), columns.shape[1]))
        for column, spline in zip(acting, splines, strict=True):
            out[..., column] = spline(time)
        return out.reshape(*np.shape(time), *values.shape[1:])

    return history


def _denser(values: np.ndarray) -> np.ndarray:
    """The sinusoids of samples (N,), mirrored at their end, taken `DENSER` times as often."""
    mirrored = np.concatenate((values, values[-2:0:-1]))
    spectrum = rfft(mirrored)
    spectrum[-1] *= 0.5  # the Nyquist line of an even number of samples stands for two once there are more samples
    dense: np.ndarray = DENSER * irfft(spectrum, DENSER * len(mirrored))
    return dense
