"""What a sensor may show beside what it is said to feel: columns of a gain, a delay, a tilt, a high-pass filter."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from scipy.linalg import solve_banded  # scipy.signal takes a third of a second to import
from scipy.sparse import csr_matrix
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.physics import observation_masks
from pinn_cli.record.gauge import GAUGE, WIDEST_DELAY
from pinn_cli.record.response import GROUND
from pinn_cli.system.functions import Jet
from pinn_cli.system.quantities import CONNECTION_FORCE, FORCE, MOTION, SUPPORT
from pinn_cli.training.band.normal_equations import NormalEquations
from pinn_cli.training.band.point import Point
from pinn_cli.training.noise_model import NoiseModel

# Kinds, as programs know them.
GAIN, DELAY, TILT, HIGH_PASS = "gain", "delay", "tilt", "high_pass"
# Of sensors of one make on one structure: all may pass no slow motion, or turn as their floors do.
COMMON = (TILT, HIGH_PASS)
# Of a record, the periods of the lowest corner of a filter that is tried; each next one is twice as high, as long as
# what the filter takes has no more than half of the channel's power.
PERIODS, MOST_TAKEN = 2.0, 0.5


@dataclass(frozen=True)
class Term:
    """Something that a model may lack.

    Attributes:
        kind: What it is, for programs.
        of: Whose it is, for people: ``connection 2``, ``acceleration of DOF 3``.
        unit: Of its value.
        scale: Value at one prior standard deviation.
        shape: What its column depends on beside: a gap or an elongation at which it yields, m, a frequency, Hz; NaN:
            nothing.
    """

    kind: str
    of: str
    unit: str
    scale: float
    shape: float = np.nan


@dataclass(frozen=True, eq=False)
class Shown:
    """One channel at a solution.

    Attributes:
        name: For people.
        quantity: That it measures.
        segments: Of its samples.
        features: Order of a derivative to features (I, S, B).
        parts: Function, order of its derivative and weight.
        felt: (J,), what it feels.
        displacement: (J,), of its DOF; None: it has none.
        residual: (J,), estimated minus measured.
        gain: Of what it shows over what it feels.
        sigma: Its noise.
        time: (J,), s.
        uncertain: Kinds of its calibration that are parameters of the model already.
        parameters: Place of a parameter of the model to what that does to it (J,).
        counted: (J,), or a number: 0 where nothing is compared.
        per_sample: Times for each of its samples.
    """

    name: str
    quantity: str
    segments: Segments
    features: Mapping[int, Tensor]
    parts: list[tuple[int, int, Tensor | float]]
    felt: np.ndarray
    displacement: np.ndarray | None
    residual: np.ndarray
    gain: float
    sigma: float
    time: np.ndarray
    uncertain: Collection[str] = ()
    parameters: Mapping[int, np.ndarray] = field(default_factory=dict)
    counted: np.ndarray | float = 1.0
    per_sample: int = 1

    def columns(self) -> Iterator[tuple[str, str, float, np.ndarray]]:
        """Kind, unit, value at one prior standard deviation, and column (J,) at that."""
        step = self.per_sample * float(np.median(np.diff(self.time)))
        felt = self.gain * self.felt
        late = WIDEST_DELAY * step
        yield GAIN, "", 1.0, felt
        yield DELAY, "s", late, -late * np.gradient(felt, self.time)
        if self.quantity == "acceleration" and self.displacement is not None and self.displacement.any():
            size = _rms(felt) / _rms(self.displacement)
            yield TILT, "m/s^2 per m", size, size * self.displacement
        yield from ((HIGH_PASS, "Hz", corner, column) for corner, column in self.taken().items())

    def taken(self) -> dict[float, np.ndarray]:
        """Corner frequency, Hz, to minus what a high-pass filter of first order takes (J,); none of uneven samples."""
        steps = np.diff(self.time)
        out: dict[float, np.ndarray] = {}
        differentiated = ("acceleration", "velocity", GROUND)
        if SUPPORT.get(self.quantity, self.quantity) not in differentiated or np.ptp(steps) > 0.02 * steps[0]:
            return out
        corner, felt = PERIODS / (self.time[-1] - self.time[0]), self.gain * self.felt
        while True:
            kept = float(np.exp(-2.0 * np.pi * corner * steps[0]))
            slow = solve_banded((1, 0), np.outer((1.0, -kept), np.ones(len(felt))), (1.0 - kept) * felt)
            if _rms(slow) ** 2 > MOST_TAKEN * _rms(felt) ** 2 or not felt.any():
                return out
            out[corner], corner = -slow, 2.0 * corner

    def border(self, equations: NormalEquations, columns: np.ndarray) -> np.ndarray:
        """(size, K), products of columns (J, K) with its own rows by the readout weights."""
        grouped = self.segments.gather(torch.as_tensor(columns).to(self.segments.mask))
        border: np.ndarray = self._rows(equations).T @ grouped.flatten(0, 1).cpu().numpy()
        return border

    def moved(self, equations: NormalEquations, weights: np.ndarray) -> np.ndarray:
        """(J, W), change of what it shows with changes of the readout weights (size, W)."""
        grouped = torch.as_tensor(self._rows(equations) @ weights).unflatten(0, self.segments.mask.shape)
        return self.segments.scatter(grouped).numpy()

    def _rows(self, equations: NormalEquations) -> csr_matrix:
        """(I S, size), of what it shows by the readout weights."""
        feature, count = self.segments.feature.cpu().numpy(), equations.layout.size
        total = csr_matrix((self.segments.mask.numel(), count))
        for function, order, weight in self.parts:
            own = (weight[..., None] if isinstance(weight, Tensor) else weight) * self.features[order]
            places = equations.layout.positions(feature, np.full_like(feature, function))
            total += sparse_rows(self.gain * own, places, count)
        return total


def sparse_rows(blocks: Tensor, places: np.ndarray, size: int) -> csr_matrix:
    """Blocks (I, S, C) as rows (I S, size); places (I, C), -1 where there is nothing."""
    groups, samples = blocks.shape[:2]
    places = np.broadcast_to(places[:, None], blocks.shape)
    there = places >= 0
    starts = np.concatenate(([0], np.cumsum(there.sum(-1))))
    return csr_matrix((blocks.cpu().numpy()[there], places[there], starts), (groups * samples, size))


@dataclass(frozen=True, eq=False)
class SensorTerm:
    """What channels may show beside what they are said to feel.

    Attributes:
        term: What.
        shown: Place of a channel to its column (J,), at one prior standard deviation.
    """

    term: Term
    shown: dict[int, np.ndarray]


def channels_shown(equations: NormalEquations, point: Point, noise: NoiseModel) -> list[Shown]:
    """Every channel of a record at a solution, those of measured inputs that are functions to be found as well."""
    return [
        *_columns_of_record(equations, point, noise),
        *_inputs(equations, point, noise),
        *_gauges(equations, point, noise),
    ]


def sensor_terms(channels: Sequence[Shown]) -> list[SensorTerm]:
    """Of every channel of motion, ground or support, and of all sensors of a quantity together."""
    found: list[SensorTerm] = []
    together: defaultdict[tuple[str, str, float], dict[int, tuple[Term, np.ndarray]]] = defaultdict(dict)
    for i, one in enumerate(channels):
        if one.quantity in (FORCE, CONNECTION_FORCE):
            continue
        for kind, unit, scale, column in one.columns():
            if kind in one.uncertain:
                continue
            term, counted = Term(kind, one.name, unit, scale), column * one.counted
            found.append(SensorTerm(term, {i: counted}))
            if kind in COMMON and one.quantity in MOTION:
                corner = scale if kind == HIGH_PASS else 0.0
                together[one.quantity, kind, corner][i] = term, counted
    for (quantity, _, _), of_all in together.items():
        if len(of_all) > 1:
            term = replace(next(iter(of_all.values()))[0], of=f"{quantity} of all sensors")
            found.append(SensorTerm(term, {i: term.scale / own.scale * by for i, (own, by) in of_all.items()}))
    return found


def sensor_border(equations: NormalEquations, channels: Sequence[Shown], terms: Sequence[SensorTerm]) -> np.ndarray:
    """(size, D), products of what channels may show with the rows of the readout weights."""
    border = np.zeros((equations.layout.size, len(terms)))
    for i, channel in enumerate(channels):
        own = [d for d, term in enumerate(terms) if i in term.shown]
        if own:
            columns = np.column_stack([terms[d].shown[i] for d in own])
            border[:, own] += channel.sigma**-2 * channel.border(equations, columns)
    return border


def _columns_of_record(equations: NormalEquations, point: Point, noise: NoiseModel) -> Iterator[Shown]:
    """The sensors that are columns of the record."""
    dynamics, record, segments = equations.dynamics, equations.problem.record, equations.observation
    jet = Jet(*equations.flat_states(segments, point)[:3])
    displacement = dynamics.sensed("displacement", jet).cpu().numpy()
    features = dict(enumerate((segments.displacement, segments.velocity, segments.acceleration)))
    for quantity, mask in observation_masks(equations.target, equations.problem.acceleration_through).items():
        if quantity in (*equations.inputs, FORCE, "observer"):
            continue
        felt = dynamics.sensed(quantity, jet).cpu().numpy()
        residual = felt - equations.target.response[quantity].cpu().numpy()
        sensing = dynamics.sensing(quantity)
        for dof in np.flatnonzero(mask.cpu().numpy()).tolist():
            parts: list[tuple[int, int, Tensor | float]] = [
                (int(function), order, float(weight))
                for order, weights in sensing
                for function, weight in zip(weights[dof].indices, weights[dof].data, strict=True)
            ]
            yield Shown(
                f"{quantity} of DOF {record.dof_name(dof)}",
                quantity,
                segments,
                features,
                parts,
                felt[:, dof],
                displacement[:, dof],
                residual[:, dof],
                1.0,
                float(noise.response[quantity][dof]),
                record.time,
            )


def _inputs(equations: NormalEquations, point: Point, noise: NoiseModel) -> Iterator[Shown]:
    """The sensors of ground and supports that are columns of the record: as they are compared between its samples."""
    for quantity, rows in equations.inputs.items():
        points, names = rows.points, equations.problem.record.support_names
        features = dict(enumerate((points.displacement, points.velocity, points.acceleration)))
        filtered = rows.filtered(equations.flat_states(points, point)).cpu().numpy()
        left = points.scatter(rows.residual(equations.states(rows.segments, point), slice(None))).cpu().numpy()
        for i in np.flatnonzero(rows.there.cpu().numpy()).tolist():
            yield Shown(
                f"{SUPPORT[quantity]} of support {names[i]}" if quantity in SUPPORT else quantity.replace("_", " "),
                quantity,
                points,
                features,
                [
                    (int(function), order, float(felt[function, i]))
                    for order, felt in enumerate(rows.felt, start=rows.order)
                    for function in np.flatnonzero(felt[:, i].cpu().numpy())
                ],
                filtered[:, i],
                None,
                left[:, i],
                1.0,
                float(noise.response[quantity][i]) * rows.refinement**0.5,
                rows.time.cpu().numpy(),
                counted=rows.told.cpu().numpy(),
                per_sample=rows.refinement,
            )


def _gauges(equations: NormalEquations, point: Point, noise: NoiseModel) -> Iterator[Shown]:
    """The sensors that have samples and a calibration of their own."""
    parameters, place = equations.parameters(point), {int(c): i for i, c in enumerate(equations.vector.column)}
    spread = equations.vector.placed(equations.scale)
    for rows, sigma in zip(equations.gauge_rows, noise.response.get(GAUGE, ()), strict=True):
        moment = rows.moment(float(rows.value("delay", parameters)))
        felt, gain = rows.felt(moment, point.unknowns, parameters), rows.value("gain", parameters)
        segments, record = moment.segments, equations.problem.record
        by = rows.by_parameter(moment, felt, gain, spread)
        dof = rows.gauge.dof
        own = f"{rows.gauge.quantity} of DOF {record.dof_name(dof or 0)}"
        name = "ground acceleration" if rows.gauge.quantity == GROUND else own
        yield Shown(
            name if dof is not None else f"sensor {rows.gauge.name}",
            rows.gauge.quantity,
            segments,
            {order: moment.derivative(order) for order in range(3)},
            felt.parts,
            segments.scatter(felt.value).cpu().numpy(),
            segments.scatter(rows.turned(moment, point.unknowns)).cpu().numpy() if rows.turning else None,
            segments.scatter(rows.residual(point.unknowns, parameters)).cpu().numpy(),
            float(gain),
            float(sigma),
            rows.time.cpu().numpy(),
            rows.places,
            {place[p]: segments.scatter(column).cpu().numpy() for p, column in by.items() if p in place},
        )


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))
