"""B-spline network: one Kolmogorov-Arnold layer in time, linear readout."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.interpolate import BSpline
from torch import Tensor

from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.network import CONTINUITIES, Continuity, NetworkDesign
from pinn_cli.record.channels import record_band
from pinn_cli.record.record import Record
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import is_whole_number, one_of, positive_number, whole_number

# Knots in one period of the record's highest frequency. Three begin to follow it, four follow its second derivative to
# a few parts in ten thousand. What they cannot follow of a cubic spring's motion passes for a weaker spring: with four,
# unknown parameters were off by 0.8 standard deviations on average over 20 records, with five by 0.2.
KNOTS_PER_PERIOD, REFINED_KNOTS_PER_PERIOD = 4.0, 5.0
# With forces that nobody measured: a spline follows frequencies up to half its knots a second. What it could follow
# beyond the record's, nobody has measured either, and near the Nyquist frequency it passes for motion in the band.
KNOTS_WITHIN_BAND = 3.0
# Collocation points in a knot interval, at least: fewer are no average.
POINTS_PER_INTERVAL = 3
# Intervals of the shortest record.
FEWEST_INTERVALS = 8
# Of a number of points that would be whole but for this: counted from knots that there are.
WHOLE_WITHIN = 1e-9


def piece_coefficients(degree: int) -> np.ndarray:
    """Polynomials of the uniform B-splines that are alive in one knot interval.

    Returns:
        (degree + 1, degree + 1): row p, column a is the coefficient of tau^p, tau in [0, 1], of the a-th alive
        B-spline, the one that began degree - a intervals ago.
    """
    spline = BSpline.basis_element(np.arange(degree + 2), extrapolate=False)
    pieces = np.empty((degree + 1, degree + 1))
    for a in range(degree + 1):
        start = degree - a
        for power in range(degree + 1):
            # One-sided Taylor coefficients at the interval's start; the last knot's own piece is the one that begins
            # there.
            pieces[power, a] = float(spline.derivative(power)(start)) / math.factorial(power)
    return pieces


class SplineNetwork(LinearReadout):
    """Uniform B-splines of one degree on [start, start + intervals * spacing], s."""

    pieces: Tensor

    def __init__(
        self,
        ndof: int,
        start: float,
        stop: float,
        intervals: int,
        degree: int,
        continuity: Continuity,
        dtype: torch.dtype,
    ) -> None:
        super().__init__(ndof, continuity, intervals + degree, dtype)
        self.start, self.intervals, self.degree = start, intervals, degree
        self.stop, self.spacing = stop, (stop - start) / intervals
        self.register_buffer("pieces", torch.as_tensor(piece_coefficients(degree), dtype=dtype))

    @property
    def free_intervals(self) -> float:
        """See :meth:`LinearReadout.free_intervals`."""
        return 1.0 / self.spacing

    def groups(self, time: Tensor, order: int) -> tuple[Tensor, Tensor, Tensor, tuple[Tensor, ...]]:
        """See :meth:`LinearReadout.groups`: one group per knot interval, degree + 1 features in each."""
        position = (time - self.start) / self.spacing
        cell = position.floor().long().clamp(0, self.intervals - 1)
        by_cell = torch.argsort(cell, stable=True)
        occupied = torch.bincount(cell, minlength=self.intervals)
        first = torch.cumsum(occupied, 0) - occupied
        shape = (self.intervals, int(occupied.max()))
        rank = torch.arange(len(time), device=time.device) - first[cell[by_cell]]
        sample = torch.zeros(shape, dtype=torch.long, device=time.device)
        mask = torch.zeros(shape, dtype=time.dtype, device=time.device)
        sample[cell[by_cell], rank] = by_cell
        mask[cell[by_cell], rank] = 1.0
        tau = (position - cell)[sample]
        feature = torch.arange(self.intervals, device=time.device)[:, None] + torch.arange(
            self.degree + 1, device=time.device
        )
        features = tuple(self._derivative(tau, q) * mask[..., None] for q in range(order + 1))
        return sample, mask, feature, features

    def _derivative(self, tau: Tensor, q: int) -> Tensor:
        """q-th time derivative of the alive B-splines at positions tau (...), (..., degree + 1)."""
        powers = torch.arange(q, self.degree + 1, device=tau.device)
        falling = torch.ones_like(powers)
        for j in range(q):
            falling = falling * (powers - j)
        monomials = tau[..., None] ** (powers - q) * falling
        return monomials @ self.pieces[q:].to(tau.dtype) / self.spacing**q


@dataclass(frozen=True)
class Spline(NetworkDesign):
    """B-splines with as many knots as the record's own band asks for.

    Attributes:
        degree: Polynomial degree; accelerations are splines of degree - 2. 5 leaves them smooth.
        knots_per_period: Knots in one period of the highest frequency that stands out of the noise in any channel;
            None: `KNOTS_PER_PERIOD`, `REFINED_KNOTS_PER_PERIOD` where parameters are unknown, `KNOTS_WITHIN_BAND` where
            forces are.
        intervals: Number of knot intervals; None: chosen by ``knots_per_period``.
        continuity: See :class:`pinn_cli.network.network.Network`.
        least_knots: Knots in one period where ``knots_per_period`` leaves them to be chosen.

    Raises:
        InputError: A setting outside its range.
    """

    name = "spline"

    degree: int = 6
    knots_per_period: float | None = None
    intervals: int | None = None
    continuity: Continuity = "exact"
    least_knots: float = KNOTS_PER_PERIOD

    def __post_init__(self) -> None:
        if not is_whole_number(self.degree) or not 3 <= self.degree <= 9:
            hint = "accelerations need two derivatives"
            raise InputError("network.degree", self.degree, "a whole number from 3 to 9", hint)
        if self.knots_per_period is not None:
            positive_number("network.knots_per_period", self.knots_per_period)
        if self.intervals is not None:
            whole_number("network.intervals", self.intervals, least=4)
        one_of("network.continuity", self.continuity, CONTINUITIES)

    def build(self, record: Record, dtype: torch.dtype = torch.float64, functions: int | None = None) -> SplineNetwork:
        """See :meth:`NetworkDesign.build`."""
        start, stop = float(record.time[0]), float(record.time[-1])
        if self.intervals is not None:
            margin = record.step  # a zero-order hold moves the collocation points half a step to the right
            start, stop, intervals = start - margin, stop + margin, self.intervals
        else:
            start, stop, intervals = self._knots(record)
        return SplineNetwork(functions or record.ndof, start, stop, intervals, self.degree, self.continuity, dtype)

    def refined(self) -> Spline:
        """See :meth:`NetworkDesign.refined`."""
        return replace(self, least_knots=max(self.least_knots, REFINED_KNOTS_PER_PERIOD))

    def within_band(self) -> Spline:
        """See :meth:`NetworkDesign.within_band`."""
        return replace(self, least_knots=KNOTS_WITHIN_BAND)

    def finer(self, factor: float, record: Record) -> Spline | None:
        """See :meth:`NetworkDesign.finer`."""
        if self.knots_per_period is not None or self.intervals is not None:
            return None
        # There are more knots than were asked for, since an interval is a whole number of points wide.
        start, stop, intervals = self._knots(record)
        return replace(self, least_knots=factor * intervals / ((stop - start) * record_band(record)))

    def _knots(self, record: Record) -> tuple[float, float, int]:
        """First and last knot, s, and the number of intervals.

        A knot interval is a whole number of collocation points wide, and its ends lie half way between two of them, so
        that averages over intervals are integrals. Where a force is held, points come half a step later than samples.
        """
        held = record.intersample == "zero_order_hold"
        wanted = (self.knots_per_period or self.least_knots) * record_band(record) * record.step  # knots per sample
        wanted = max(wanted, FEWEST_INTERVALS / len(record.time))
        refinement = 1 if held else max(1, math.ceil(POINTS_PER_INTERVAL * wanted - WHOLE_WITHIN))
        points = max(1, math.floor(refinement / wanted + WHOLE_WITHIN))
        step = record.step / refinement
        spacing = points * step
        lead = 0.0 if held else 0.5 * step
        start, stop = float(record.time[0]) - lead, float(record.time[-1]) + step - lead
        intervals = math.ceil((stop - start) / spacing - 1e-6)
        return start, start + intervals * spacing, intervals
