"""What a structure does under the force of a record and the motion of its ground."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import Polynomial
from scipy.interpolate import BSpline, make_interp_spline

from pinn_cli.record.between_samples import NOISIEST, REACH, refined_history, refined_times
from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.record.runge_kutta import Force
from pinn_cli.record.simulation import simulate
from pinn_cli.record.spectrum import lowest_level
from pinn_cli.record.steps import TooStiffError as TooStiffError
from pinn_cli.record.steps import has_equation_of_motion, method_needed, with_slow_followers
from pinn_cli.record.supports import told_by

if TYPE_CHECKING:
    from pinn_cli.system.structure import Structure

# A spline goes through so many times as many samples, which kriging tells: it follows a history up to 0.9 of the
# Nyquist frequency to 1e-5. Through the samples themselves it is off by 7e-4 up to half of that frequency, by 6e-3 up
# to 0.65 of it and by a tenth up to 0.9; in the first intervals and the last by some forty times as much. Of white
# noise the two differ by a seventh: a quarter allows for chance.
DENSER, SPLINE_DEGREE, AT_ENDS, OF_NOISE = 4, 5, 40.0, 0.25


def resimulate(
    structure: Structure,
    record: Record,
    initial: Sequence[np.ndarray],
    force: np.ndarray | None = None,
    first: int = 0,
    ground: np.ndarray | None = None,
) -> Response:
    """The response of a structure to the force of a record, which does between samples what the record says.

    The measured motion of its ground acts as well, through the same spline; the acceleration is in the record's frame.

    Args:
        structure: Any.
        record: For its times, its ``intersample`` behaviour and its frame.
        initial: Displacement and velocity (n,) at sample ``first``.
        force: (N, n), N, another force at the record's samples; None: the record's own.
        first: Sample to begin with.
        ground: (N,), m/s^2, another ground acceleration at the record's samples; None: the record's own.

    Raises:
        OverflowsError: The response does not stay finite.
        TooStiffError: Even implicit steps would be too many, or a mass is zero.
    """
    if not has_equation_of_motion(structure):
        raise TooStiffError("a mass of it is zero")
    structure = with_slow_followers(structure, record.step)
    method, _ = method_needed(structure, record.step)
    hold = "zero_order" if record.intersample == "zero_order_hold" else "exact"
    time, force = record.time[first:], (record.force if force is None else force)[first:]
    moved = record.ground_acceleration if ground is None else ground
    shaking = None if moved is None else force_spline(time, moved[first:])
    acting, carried = _between_samples(time, force, hold), support_motion(record, first)
    return simulate(
        structure, acting, time, hold, method, initial=initial, ground=shaking, supports=carried, frame=record.frame
    )


def support_motion(record: Record, first: int = 0) -> Force | None:
    """From times (M,) from a sample on to the motion (M, 3, S) of the supports, by splines; None where none moves.

    A velocity or an acceleration is integrated from :attr:`Record.supports_begin`, and so is the sensor's noise.
    """
    if not record.supports:
        return None
    time = record.time[first:]
    begins = np.zeros((2, len(record.support_names))) if record.supports_begin is None else record.supports_begin
    jets = []
    for i, (quantity, order) in enumerate(told_by(record)):
        spline = dense_spline(time, record.supports[quantity][first:, i])
        # What is integrated begins as it is known to: a polynomial more.
        start = Polynomial([begins[k, i] / math.factorial(k) for k in range(order)] or [0.0])
        jets.append((spline.antiderivative(order), order, start))

    def motion(at: np.ndarray) -> np.ndarray:
        out = np.empty((len(at), 3, len(jets)))
        for i, (history, order, start) in enumerate(jets):
            for k in range(3):
                out[:, k, i] = history(at, k) + (start.deriv(k)(at - time[0]) if order > k else 0.0)
        return out

    return motion


def _between_samples(time: np.ndarray, force: np.ndarray, hold: str) -> Force:
    """The force at any time of the record, from its samples (N, n)."""
    if hold == "zero_order":
        return lambda _: force  # a simulation that holds the force asks for it at the samples only
    return force_spline(time, force)


def force_spline(time: np.ndarray, force: np.ndarray) -> Force:
    """A band-limited history at any time, from its samples (N, ...) at times (N,).

    Most columns of a force are zero as a rule, and stay so.
    """
    columns = force.reshape(len(force), -1)
    acting = np.flatnonzero(columns.any(axis=0))
    spline = dense_spline(time, columns[:, acting]) if acting.size else None

    def history(at: np.ndarray) -> np.ndarray:
        out = np.zeros((*np.shape(at), columns.shape[1]))
        if spline is not None:
            out[..., acting] = spline(at)
        return out.reshape(*np.shape(at), *force.shape[1:])

    return history


def dense_spline(time: np.ndarray, samples: np.ndarray) -> BSpline:
    """Of band-limited histories (N,) or (N, n) with samples at times (N,)."""
    dense = _denser(time, samples.reshape(len(samples), -1)).reshape(-1, *samples.shape[1:])
    return make_interp_spline(refined_times(time, DENSER), dense, k=SPLINE_DEGREE)


def _denser(time: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Histories (N, n) at `DENSER` times as many times.

    At the ends of a record kriging, which takes them to fill the band, knows less of a slow history than the spline
    through the samples. How far that one is off shows in the middle, beside what white noise makes of the two: each
    counts by its variance.
    """
    noise = np.array([lowest_level(column, float(time[1] - time[0])) for column in samples.T])
    dense, spread = refined_history(samples, DENSER)
    # At the ends what takes the samples to be exact makes a step of 40 times their noise.
    part = float(min(np.max(noise / np.sqrt(np.mean(samples**2, axis=0))), NOISIEST))
    ends = np.minimum(np.arange(len(dense)), np.arange(len(dense))[::-1]) < REACH // 2 * DENSER
    dense[ends] = refined_history(samples, DENSER, part)[0][ends]
    off = make_interp_spline(time, samples, k=SPLINE_DEGREE)(refined_times(time, DENSER)) - dense
    quarter = len(dense) // 4
    of_spline = AT_ENDS**2 * np.maximum(np.var(off[quarter:-quarter], axis=0) - (OF_NOISE * noise) ** 2, 0.0) + noise**2
    of_kriging = np.outer(spread**2, np.mean(samples**2, axis=0))
    total = of_kriging + of_spline
    return dense + off * np.divide(of_kriging, total, out=np.zeros_like(total), where=total > 0.0)
