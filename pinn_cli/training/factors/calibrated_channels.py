"""Channels with samples and a calibration of their own: its numbers are known, believed or unknown.

The equation of a sensor's high-pass filter: p^(order) + ... + a_0 p = x, of which the sensor shows p^(order).

The state p is a function of time as the motion is, and x is what the sensor feels. The equation holds on the average
over every knot interval, as the equation of motion does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.record.channel import CALIBRATED, DELAYS_ALLOWED, Channel, filter_polynomial
from pinn_cli.system.functions import Jet
from pinn_cli.system.quantities import CALIBRATION_UNITS, HIGH_PASS
from pinn_cli.training.factors.channel_at_point import ChannelAtPoint, Feels, Part, WeightedSum, felt_by, weighted
from pinn_cli.training.factors.factor import Channels, Factor, Piece
from pinn_cli.training.factors.frame import Frame
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_matrix.row_sums import Rows, RowSums, Touched
from pinn_cli.training.sensor_samples import SensorSamples

# What the equation may leave, over the rms of the channel: less than any sensor's noise.
EXACT = 1e-4


class Moment(NamedTuple):
    """The features at a channel's samples, each looked at so much earlier as the channel is late.

    Attributes:
        delay: s.
        segments: I groups of S samples.
        features: (I, S, B), and three derivatives.
    """

    delay: float
    segments: Segments
    features: tuple[Tensor, ...]


@dataclass(frozen=True, eq=False)
class Shown:
    """What a channel shows at a point, and what that is made of.

    Attributes:
        moment: Its samples.
        measurand: (I, S).
        gain: Of what it shows over that.
        residual: (I, S), estimated minus measured.
        parts: Derivative of what it feels.
        columns: Place of a parameter to what that does to what it shows (I, S), per prior standard deviation.
    """

    moment: Moment
    measurand: Tensor
    gain: Tensor
    residual: Tensor
    parts: list[Part]
    columns: dict[int, Tensor]


class CalibratedChannel:
    """One of them.

    Attributes:
        places: Kind of a number of its calibration that is uncertain to its place among all parameters.
        kept: (all samples,) bool, those of them that felt a motion within the record.
        time, measured: (J,), s, and samples that felt a motion within the record.
        feels: What it feels before a filter.
        state: The function that is the state of its filter, see the top of this page; None:
            it is behind none.
    """

    def __init__(self, channel: Channel, frame: Frame) -> None:
        self.channel, self.frame = channel, frame
        self.places = {
            p.kind: frame.vector.first[p.kind] + p.index
            for p in frame.vector.moving
            if p.kind in CALIBRATION_UNITS and p.index == channel.index
        }
        network = frame.network
        self.kept = self._inside(float(network.start), float(network.stop))  # type: ignore[arg-type]
        self.time, self.measured = (
            torch.as_tensor(x[self.kept]).to(frame.target.force) for x in (channel.time, channel.measured)
        )
        self.since = self.time - channel.start
        self.feels, filters = felt_by(channel, frame.dynamics, frame.vector), frame.dynamics.inputs.filters
        has_state = channel.index in filters
        self.state = frame.dynamics.filters.start + filters.index(channel.index) if has_state else None
        self._moment: Moment | None = None

    def _inside(self, start: float, stop: float) -> np.ndarray:
        """(J,) bool, samples at which it felt a motion within the record, whatever its delay may turn out to be."""
        (first, last), margin = self._delays, 1e-9 * (stop - start)
        kept: np.ndarray = (self.channel.time - last >= start - margin) & (self.channel.time - first <= stop + margin)
        return kept

    @property
    def _delays(self) -> tuple[float, float]:
        """The least and the largest with which its samples felt a motion within the record."""
        delay = self.channel.number("delay")
        return delay.value - DELAYS_ALLOWED * delay.std, delay.value + DELAYS_ALLOWED * delay.std

    def reaches(self, parameters: Mapping[str, Tensor]) -> bool:
        """Whether its delay is one of those: with another one, samples ask for a motion that there is none of."""
        first, last = self._delays
        return "delay" not in self.places or first <= float(self.value("delay", parameters)) <= last

    def value(self, kind: str, parameters: Mapping[str, Tensor]) -> Tensor:
        """One number of the calibration."""
        return parameters[kind][self.channel.index]

    def moment(self, delay: float) -> Moment:
        """The features as a delay has them; kept until it changes."""
        if self._moment is None or self._moment.delay != delay:
            time, network = self.time - delay, self.frame.network
            sample, mask, feature, jet = network.groups(time, 3)
            segments = Segments(sample, mask, feature, torch.stack(jet[:3], 1), None, network.count, len(time))
            self._moment = Moment(delay, segments, (*segments.orders, jet[3]))
        return self._moment

    @property
    def shows(self) -> Feels:
        """What it shows but for its calibration: what it feels, or of a filter a derivative of its state."""
        return self.feels if self.state is None else WeightedSum([Part(self.state, self.channel.filter_order, 1.0)])

    def residual(self, point: Point) -> Tensor:
        """(I, S), what it would show without noise minus what it shows."""
        parameters = self.frame.parameters(point)
        moment = self.moment(float(self.value("delay", parameters)))
        return self._residual(moment, self.shows.value(self.frame.jet(moment.segments, point), parameters), parameters)

    def residual_of_samples(self, point: Point) -> np.ndarray:
        """(all samples,), measured minus estimated, in what it feels; NaN where it felt no motion within the record."""
        parameters, out = self.frame.parameters(point), np.full(len(self.kept), np.nan)
        shown = self.moment(float(self.value("delay", parameters))).segments.scatter(self.residual(point))
        out[self.kept] = -(shown / self.value("gain", parameters)).numpy()
        return out

    def _residual(self, moment: Moment, measurand: Tensor, parameters: Mapping[str, Tensor]) -> Tensor:
        gain, offset, drift = (self.value(kind, parameters) for kind in ("gain", "offset", "drift"))
        gather = moment.segments.gather
        shown = gain * measurand + offset + drift * gather(self.since)
        return (shown - gather(self.measured)) * moment.segments.mask

    def at(self, point: Point) -> Shown:
        """What it shows, linearised."""
        frame, parameters = self.frame, self.frame.parameters(point)
        moment = self.moment(float(self.value("delay", parameters)))
        jet, gain, shows = frame.jet(moment.segments, point), self.value("gain", parameters), self.shows
        measurand, (parts, by) = shows.value(jet, parameters), shows.linearised(jet, parameters)
        by = {place: gain * column for place, column in by.items()}
        numbers = {"gain": measurand, "offset": torch.ones_like(measurand), "drift": moment.segments.gather(self.since)}
        by |= {self.places[kind]: column for kind, column in numbers.items() if kind in self.places}
        if "delay" in self.places:
            by[self.places["delay"]] = -gain * self._changed(moment, parts, point, more=1)
        spread, mask = frame.spread_by_place, moment.segments.mask
        columns = {place: spread[place] * column * mask for place, column in by.items()}
        return Shown(moment, measurand, gain, self._residual(moment, measurand, parameters), parts, columns)

    def _changed(self, moment: Moment, parts: list[Part], step: Point, more: int = 0) -> Tensor:
        """(I, S), change of what it feels with a step of the readout weights, or with one derivative more."""
        local = self.frame.layout.weights(step.unknowns)[moment.segments.feature]  # (I, B, functions)
        out = local.new_zeros(moment.segments.mask.shape)
        for function, order, weight in parts:
            out = out + weight * (moment.features[order + more] @ local[..., function, None])[..., 0]
        return out

    def moved(self, shown: Shown, step: Point) -> Tensor:
        """(I, S), change of what it shows with a small step."""
        by = self.frame.vector.placed(step.parameters)
        out = shown.gain * self._changed(shown.moment, shown.parts, step) * shown.moment.segments.mask
        for place, column in shown.columns.items():
            out = out + by[place] * column
        return out

    def add_to(self, sums: RowSums, point: Point, weight: float) -> None:
        """Add the weighted products of its rows; ``weight`` is that of every sample."""
        shown = self.at(point)
        features = summed_features(shown.parts, shown.moment.features, shown.gain)
        add_products(sums, shown.moment.segments, features, shown.residual, shown.columns, weight)

    def at_point(self, point: Point, sigma: float) -> ChannelAtPoint:
        """See :meth:`Channels.at`."""
        shown, channel = self.at(point), self.channel
        segments, flat = shown.moment.segments, lambda x: shown.moment.segments.scatter(x).numpy()
        number = {int(place): i for i, place in enumerate(self.frame.vector.column)}
        displacement = None
        if channel.quantity == "acceleration":
            turning = WeightedSum(weighted(self.frame.dynamics, "displacement", channel.weights))
            displacement = flat(turning.value(self.frame.jet(segments, point), {}))
        return ChannelAtPoint(
            channel.name,
            channel.quantity,
            segments,
            shown.moment.features,
            shown.parts,
            flat(shown.measurand),
            displacement,
            flat(shown.residual),
            self.time.numpy(),
            sigma,
            float(shown.gain),
            self.places,
            {number[place]: flat(column) for place, column in shown.columns.items() if place in number},
        )


class CalibratedChannels(Channels):
    """All of them."""

    name = CALIBRATED

    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        record = frame.problem.record
        self.channels = [CalibratedChannel(channel, frame) for channel in record.calibrated]
        self.sensors = [SensorSamples(channel, record) for channel in record.calibrated]
        self.present = np.ones(len(self.channels), dtype=bool)
        self.samples = np.array([len(channel.time) for channel in self.channels])
        self.acting = np.array([channel.is_input for channel in record.calibrated], dtype=bool)

    def residuals(self, point: Point) -> Iterator[Piece]:
        """See :meth:`Channels.residuals`."""
        for i, channel in enumerate(self.channels):
            residual = channel.residual(point)
            yield Piece(slice(i, i + 1), 0, len(residual), residual[..., None])

    def moved(self, point: Point, steps: Sequence[Point]) -> Iterator[tuple[slice, list[Tensor]]]:
        """See :meth:`Channels.moved`."""
        for i, channel in enumerate(self.channels):
            shown = channel.at(point)
            yield slice(i, i + 1), [channel.moved(shown, step)[..., None] for step in steps]

    def residuals_of_samples(self, point: Point) -> dict[str, np.ndarray]:
        """See :meth:`Channels.residuals_of_samples`."""
        return {channel.channel.key: channel.residual_of_samples(point) for channel in self.channels}

    def loss(self, point: Point, noise: NoiseModel) -> float:
        """Infinite where a delay is out of the record's reach."""
        parameters = self.frame.parameters(point)
        if not all(channel.reaches(parameters) for channel in self.channels):
            return math.inf
        return float(np.sum(self.squares(point) / noise.response[CALIBRATED] ** 2))

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """See :meth:`Factor.add_to`."""
        for channel, sigma in zip(self.channels, noise.response[CALIBRATED], strict=True):
            channel.add_to(sums, point, float(sigma) ** -2)

    def at(self, point: Point, noise: NoiseModel) -> Iterator[ChannelAtPoint]:
        """See :meth:`Channels.at`."""
        for channel, sigma in zip(self.channels, noise.response[CALIBRATED], strict=True):
            yield channel.at_point(point, float(sigma))


class Gains(Factor):
    """What is most probable together with one motion is a gain that is too large.

    Smaller motions are more probable by their prior. Over all motions the density of a gain has a factor gain^-taken,
    with the values of its sensor that the motion has taken up (the determinant of the motion's Hessian).
    """

    name = "gain"

    def __init__(self, frame: Frame, channels: Sequence[CalibratedChannel]) -> None:
        super().__init__(frame)
        self.channels = [channel for channel in channels if "gain" in channel.places]

    def _counted(self, noise: NoiseModel) -> list[tuple[CalibratedChannel, float]]:
        if noise.taken_up is None:
            return []
        return [(channel, float(noise.taken_up[channel.channel.index])) for channel in self.channels]

    def loss(self, point: Point, noise: NoiseModel) -> float:
        """See :meth:`Factor.loss`."""
        parameters = self.frame.parameters(point)
        terms = (taken * channel.value("gain", parameters).abs().log() for channel, taken in self._counted(noise))
        return float(sum(2.0 * float(term) for term in terms))

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """See :meth:`Factor.add_to`."""
        parameters, spread = self.frame.parameters(point), self.frame.spread_by_place
        for channel, taken in self._counted(noise):
            place = channel.places["gain"]
            sums.slope[place] += taken * float(spread[place] / channel.value("gain", parameters))


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
        segments: Of their times.
        features: Function to what its features are in the rows (I, S, B).
        residual: (I, S).
        columns: Place of a parameter to what that does to the rows (I, S), per prior deviation.
        weight: Of every row.
    """
    root = weight**0.5
    of_functions = ((root * phi).permute(2, 1, 0).numpy() for phi in features.values())
    first = sums.rank[list(features)].tolist()
    assert max(first) - min(first) <= sums.reach, "functions that one row feels stand within the band"
    touched = [Touched(place, 0, phi[None, ..., None]) for place, phi in zip(first, of_functions, strict=True)]
    by = root * torch.stack([*columns.values(), residual]).mT
    places = np.array(list(columns), dtype=np.int64)[:, None]
    sums.add(Rows(segments.feature, touched, places, by[..., None].numpy()))


def summed_features(parts: Sequence[Part], features: Sequence[Tensor], gain: Tensor | float = 1.0) -> dict[int, Tensor]:
    """Function to the sum of its features (I, S, B) in rows that are made of some parts.

    Args:
        parts: Of the rows.
        features: (I, S, B), and derivatives of them.
        gain: Of all of them.
    """
    by_function: dict[int, Tensor] = {}
    for function, order, factor in parts:
        added = (factor[..., None] if isinstance(factor, Tensor) and factor.ndim else factor) * features[order]
        by_function[function] = by_function[function] + added if function in by_function else added
    return {function: gain * phi for function, phi in by_function.items()}


class SensorFilter(Factor):
    """That of one channel, whose state is a function of time."""

    name = "filter"

    def __init__(self, frame: Frame, channel: CalibratedChannel, state: int) -> None:
        super().__init__(frame)
        self.channel, self.state, self.order = channel, state, channel.channel.filter_order
        self.segments = frame.physics
        self.features = tuple(frame.averaged(phi) for phi in self.segments.orders)
        self.weight = (EXACT * (float(np.std(channel.channel.measured)) or 1.0)) ** -2

    def _corner(self, parameters: Mapping[str, Tensor]) -> float:
        return 2.0 * math.pi * float(self.channel.value(HIGH_PASS, parameters))

    def _jet(self, point: Point) -> Jet:
        """Functions at the points, or their averages."""
        local = self.frame.layout.weights(point.unknowns)[self.segments.feature]
        return Jet(*(phi @ local for phi in self.features))

    def _state(self, parameters: Mapping[str, Tensor]) -> list[Part]:
        """What the state asks for."""
        polynomial = filter_polynomial(self._corner(parameters), self.order)
        return [Part(self.state, order, a) for order, a in enumerate(polynomial)]

    def residual(self, point: Point) -> Tensor:
        """(I, 1), or (I, S) at points, what the state asks for less what is felt."""
        return self._residual(self._jet(point), self.frame.parameters(point))

    def _residual(self, jet: Jet, parameters: Mapping[str, Tensor]) -> Tensor:
        asked = WeightedSum(self._state(parameters)).value(jet, parameters)
        return asked - self.channel.feels.value(jet, parameters)

    def loss(self, point: Point, noise: NoiseModel) -> float:
        """See :meth:`Factor.loss`."""
        return self.weight * float(self.residual(point).square().sum())

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """See :meth:`Factor.add_to`."""
        jet, parameters, spread = self._jet(point), self.frame.parameters(point), self.frame.spread_by_place
        input_parts, by = self.channel.feels.linearised(jet, parameters)
        parts = self._state(parameters) + [Part(f, order, -w) for f, order, w in input_parts]
        by, corner = {place: -column for place, column in by.items()}, self._corner(parameters)
        if HIGH_PASS in self.channel.places:
            slope = (1.0,) if self.order == 1 else (2.0 * corner, math.sqrt(2.0))
            of_state = WeightedSum([Part(self.state, order, 2.0 * math.pi * a) for order, a in enumerate(slope)])
            by[self.channel.places[HIGH_PASS]] = of_state.value(jet, parameters)
        columns = {place: spread[place] * column for place, column in by.items()}
        features = summed_features(parts, self.features)
        add_products(sums, self.segments, features, self._residual(jet, parameters), columns, self.weight)
