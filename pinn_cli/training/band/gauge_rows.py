"""Rows of sensors that take more to describe than a column of the record: gauges, with their calibration."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.linear_readout import LinearReadout, Segments
from pinn_cli.record.gauge import DELAYS_ALLOWED, Gauge
from pinn_cli.record.response import GROUND
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.functions import Jet
from pinn_cli.system.parameters import ParameterVector
from pinn_cli.system.quantities import CALIBRATION_UNITS, CONNECTION_FORCE, TILT
from pinn_cli.training.band.row_sums import Rows, RowSums, Touched

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pinn_cli.training.band.layout import BandLayout


class Moment(NamedTuple):
    """The features at a gauge's samples, each looked at so much earlier as the gauge is late.

    Attributes:
        delay: s.
        segments: I groups of S samples.
        third: (I, S, B), third derivative of the features.
    """

    delay: float
    segments: Segments
    third: Tensor

    def derivative(self, order: int) -> Tensor:
        """(I, S, B), a derivative of the features."""
        s = self.segments
        return (s.displacement, s.velocity, s.acceleration, self.third)[order]


@dataclass(frozen=True, eq=False)
class Felt:
    """What a gauge feels at its samples, and what that is made of.

    Attributes:
        value: (I, S).
        rate: (I, S), its derivative in time.
        parts: Function, order of its derivative, and factor, a number or (I, S): the derivative of the value.
        by_parameter: Place of a parameter of the structure to the derivative (I, S) by it.
    """

    value: Tensor
    rate: Tensor
    parts: list[tuple[int, int, Tensor | float]]
    by_parameter: dict[int, Tensor]


def calibrations(gauges: Sequence[Gauge]) -> dict[str, Tensor]:
    """Kind to the numbers of all gauges as they are known or believed, (gauges,); none without gauges."""
    if not gauges:
        return {}
    values = {kind: [gauge.of(kind).value for gauge in gauges] for kind in CALIBRATION_UNITS}
    return {kind: torch.tensor(of_kind, dtype=torch.float64) for kind, of_kind in values.items()}


class GaugeRows:
    """The rows of one gauge, linear in the readout where what it feels is.

    Args:
        gauge: Which.
        number: Its own among all gauges, counted from 0.
        network: Fixed features, linear readout.
        dynamics: The unknown functions of time.
        layout: Of the readout weights.
        vector: Of all uncertain parameters.
        like: A tensor of the dtype and device wanted.
    """

    def __init__(
        self,
        gauge: Gauge,
        number: int,
        network: LinearReadout,
        dynamics: Dynamics,
        layout: BandLayout,
        vector: ParameterVector[Tensor],
        like: Tensor,
    ) -> None:
        self.gauge, self.number, self.network, self.dynamics = gauge, number, network, dynamics
        self.layout, self.vector = layout, vector
        self.places = {
            p.kind: vector.first[p.kind] + number
            for p in vector.moving
            if p.kind in CALIBRATION_UNITS and p.index == number
        }
        kept = self._inside(float(network.start), float(network.stop))  # type: ignore[arg-type]
        self.time, self.measured = (torch.as_tensor(x[kept]).to(like) for x in (gauge.time, gauge.values))
        self.since = self.time - gauge.start
        self.own = [] if gauge.quantity == CONNECTION_FORCE else self._constant_parts(gauge.quantity)
        self.turning = self._constant_parts("displacement") if gauge.quantity == "acceleration" else []
        filters = dynamics.inputs.filters
        # Behind a filter it shows a derivative of the filter's state, a function whose equation holds what is felt.
        self.state = dynamics.filters.start + filters.index(number) if number in filters else None
        self._moment: Moment | None = None

    def _inside(self, start: float, stop: float) -> np.ndarray:
        """(J,) bool, samples at which it felt a motion within the record, whatever its delay may turn out to be."""
        (first, last), margin = self._delays, 1e-9 * (stop - start)
        kept: np.ndarray = (self.gauge.time - last >= start - margin) & (self.gauge.time - first <= stop + margin)
        return kept

    @property
    def _delays(self) -> tuple[float, float]:
        """The least and the largest with which its samples felt a motion within the record."""
        delay = self.gauge.of("delay")
        return delay.value - DELAYS_ALLOWED * delay.std, delay.value + DELAYS_ALLOWED * delay.std

    def reaches(self, parameters: Mapping[str, Tensor]) -> bool:
        """Whether its delay is one of those: with another one, samples ask for a motion that there is none of."""
        first, last = self._delays
        return "delay" not in self.places or first <= float(self.value("delay", parameters)) <= last

    @property
    def samples(self) -> int:
        """Those that are compared with the motion."""
        return len(self.time)

    def _constant_parts(self, quantity: str) -> list[tuple[int, int, Tensor | float]]:
        """Function, order of its derivative and weight, of sensors of a quantity that feel the same weighted sum."""
        weights: defaultdict[tuple[int, int], float] = defaultdict(float)
        channels = {0: 1.0} if quantity == GROUND else self.gauge.weights
        for order, matrix in self.dynamics.sensing(quantity):
            for channel, weight in channels.items():
                row = matrix[channel]
                for function, share in zip(row.indices.tolist(), row.data.tolist(), strict=True):
                    weights[function, order] += weight * share
        return [(function, order, weight) for (function, order), weight in weights.items() if weight]

    def moment(self, delay: float) -> Moment:
        """The features as a delay has them; kept until it changes."""
        if self._moment is None or self._moment.delay != delay:
            time = self.time - delay
            sample, mask, feature, jet = self.network.groups(time, 3)
            count = self.network.count
            segments = Segments(sample, mask, feature, jet[0], jet[1], jet[2], None, count, len(time))
            self._moment = Moment(delay, segments, jet[3])
        return self._moment

    def value(self, kind: str, parameters: Mapping[str, Tensor]) -> Tensor:
        """One number of the calibration."""
        return parameters[kind][self.number]

    def residual(self, unknowns: Tensor, parameters: Mapping[str, Tensor]) -> Tensor:
        """(I, S), what it would show without noise minus what it shows."""
        moment = self.moment(float(self.value("delay", parameters)))
        return self._residual(moment, self.felt(moment, unknowns, parameters), parameters)

    def _residual(self, moment: Moment, felt: Felt, parameters: Mapping[str, Tensor]) -> Tensor:
        gain, offset, drift = (self.value(kind, parameters) for kind in ("gain", "offset", "drift"))
        gather = moment.segments.gather
        shown = gain * felt.value + offset + drift * gather(self.since)
        return (shown - gather(self.measured)) * moment.segments.mask

    def felt(self, moment: Moment, unknowns: Tensor, parameters: Mapping[str, Tensor]) -> Felt:
        """What it feels at a point."""
        local = self.layout.weights(unknowns)[moment.segments.feature]  # (I, B, functions)
        if self.gauge.quantity == CONNECTION_FORCE:
            return self._connection(moment, local, parameters)
        parts = self.parts(parameters)
        if self.state is not None:
            parts = [(self.state, self.gauge.filter_order, 1.0)]
        value, rate = (self._summed(moment, local, parts, more) for more in (0, 1))
        by: dict[int, Tensor] = {}
        if self.state is None and TILT in self.places:
            by[self.places[TILT]] = self._summed(moment, local, self.turning)
        return Felt(value, rate, parts, by)

    def parts(self, parameters: Mapping[str, Tensor]) -> list[tuple[int, int, Tensor | float]]:
        """Function, order of its derivative and weight, of what it feels, a tilt included; of motions and forces."""
        tilt = self.value(TILT, parameters)
        return self.own + [(f, order, tilt * w) for f, order, w in self.turning if TILT in self.gauge.calibration]

    def turned(self, moment: Moment, unknowns: Tensor) -> Tensor:
        """(I, S), the displacement with which it may tilt."""
        return self._summed(moment, self.layout.weights(unknowns)[moment.segments.feature], self.turning)

    @staticmethod
    def _summed(moment: Moment, local: Tensor, parts: list[tuple[int, int, Tensor | float]], more: int = 0) -> Tensor:
        """(I, S), a sum of functions, or with one derivative more."""
        out = local.new_zeros(moment.segments.mask.shape)
        for function, order, weight in parts:
            out = out + weight * (moment.derivative(order + more) @ local[..., function, None])[..., 0]
        return out

    def _connection(self, moment: Moment, local: Tensor, parameters: Mapping[str, Tensor]) -> Felt:
        """The force of a connection, linearised."""
        dynamics, structure, c = self.dynamics, self.dynamics.structure, self.gauge.connection
        jet = Jet(*(moment.derivative(order) @ local for order in range(3)))
        u, v = (dynamics.stretching(x) for x in (jet.value, jet.rate))
        z = jet.value[..., dynamics.hidden] if len(structure.memory) else None
        force = structure.connection_force(structure.elongation(u), structure.elongation(v), parameters, z)[..., c]
        slope = structure.linearise(u, v, parameters)
        stretch = dynamics.stretched[c]
        parts: list[tuple[int, int, Tensor | float]] = []
        for function, weight in zip(stretch.indices.tolist(), stretch.data.tolist(), strict=True):
            parts += [(function, 0, weight * slope.stiffness[..., c]), (function, 1, weight * slope.damping[..., c])]
        if c in structure.memory:
            parts.append((dynamics.hidden.start + int(np.searchsorted(structure.memory, c)), 0, 1.0))
        by = {
            self.vector.first[p.kind] + p.index: slope.by_parameter[p.kind][..., own].sum(-1)
            for p in self.vector.moving
            if p.kind in slope.by_parameter
            and (own := (dynamics.branch(p.kind) == c) & (structure.carriers[p.kind][1] == p.index)).any()
        }
        return Felt(force, self._summed(moment, local, parts, 1), parts, by)

    def moved(
        self, unknowns: Tensor, parameters: Mapping[str, Tensor], step: Tensor, by: Tensor, spread: Tensor
    ) -> Tensor:
        """(I, S), change of what it shows with a small step.

        Args:
            unknowns: (size,), readout weights where the step begins.
            parameters: Kind to values there.
            step: (size,), of the readout weights.
            by: (places,), of the parameters, in prior standard deviations.
            spread: See :meth:`add_to`.
        """
        moment = self.moment(float(self.value("delay", parameters)))
        felt, gain = self.felt(moment, unknowns, parameters), self.value("gain", parameters)
        local = self.layout.weights(step)[moment.segments.feature]
        out = gain * self._summed(moment, local, felt.parts) * moment.segments.mask
        for place, column in self.by_parameter(moment, felt, gain, spread).items():
            out = out + by[place] * column
        return out

    def add_to(
        self, sums: RowSums, unknowns: Tensor, parameters: Mapping[str, Tensor], weight: float, spread: Tensor
    ) -> None:
        """Add the weighted products of its rows at a point.

        Args:
            sums: What they are added to.
            unknowns: (size,), readout weights.
            parameters: Kind to values.
            weight: Of every sample.
            spread: (places,), prior standard deviation of every parameter, 0 of those that are held.
        """
        moment = self.moment(float(self.value("delay", parameters)))
        felt, segments = self.felt(moment, unknowns, parameters), moment.segments
        residual = self._residual(moment, felt, parameters)
        gain = self.value("gain", parameters)
        features = {f: gain * phi for f, phi in summed_features(felt.parts, moment.derivative).items()}
        columns = self.by_parameter(moment, felt, gain, spread)
        add_products(sums, segments, features, residual, columns, weight)

    def by_parameter(self, moment: Moment, felt: Felt, gain: Tensor, spread: Tensor) -> dict[int, Tensor]:
        """Place of every uncertain parameter that it feels to what that does to it (I, S), per prior deviation."""
        mask = moment.segments.mask
        by_kind = {
            "gain": felt.value,
            "offset": torch.ones_like(mask),
            "drift": moment.segments.gather(self.since),
            "delay": -gain * felt.rate,
        }
        own = {place: by_kind[kind] for kind, place in self.places.items() if kind in by_kind}
        every = own | {place: gain * by for place, by in felt.by_parameter.items()}
        return {place: spread[place] * by * mask for place, by in every.items()}


def add_products(
    sums: RowSums,
    segments: Segments,
    features: Mapping[int, Tensor],
    residual: Tensor,
    columns: Mapping[int, Tensor],
    weight: float,
) -> None:
    """Add the weighted products of rows.

    Args:
        sums: What they are added to.
        segments: Of their times, I groups of S.
        features: Function to what its features are in the rows (I, S, B).
        residual: (I, S).
        columns: Place of a parameter to what that does to the rows (I, S), per prior deviation.
        weight: Of every row.
    """
    root = weight**0.5
    of_functions = ((root * phi).permute(2, 1, 0).cpu().numpy() for phi in features.values())
    first = sums.rank[list(features)].tolist()
    assert max(first) - min(first) <= sums.reach, "functions that one row feels stand within the band"
    touched = [Touched(place, 0, phi[None, ..., None]) for place, phi in zip(first, of_functions, strict=True)]
    by = root * torch.stack([*columns.values(), residual]).mT
    places = np.array(list(columns), dtype=np.int64)[:, None]
    sums.add(Rows(segments.feature, touched, places, by[..., None].cpu().numpy()))


def summed_features(
    parts: Sequence[tuple[int, int, Tensor | float]], derivative: Callable[[int], Tensor]
) -> dict[int, Tensor]:
    """Function to the sum of its features (I, S, B) in rows that are made of some parts."""
    features: dict[int, Tensor] = {}
    for function, order, factor in parts:
        added = (factor[..., None] if isinstance(factor, Tensor) and factor.ndim else factor) * derivative(order)
        features[function] = features[function] + added if function in features else added
    return features
