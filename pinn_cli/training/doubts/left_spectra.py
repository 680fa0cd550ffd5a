"""What a solution leaves of a record, band by band of frequency, and how much less with further parameters.

A discrepancy that is white stands for whatever the model leaves out. Where an estimate follows its sensors, that is
mostly their noise, differentiated, at high frequencies, and the level of the white force says nothing of what is left
at low ones. So every band has a level of its own: with E_b the whitened energy of n_b residuals in band b, once the
motion has adapted, the record is most probable where

    sum over b of n_b log E_b / 2

is least (Whittle's likelihood with a spectrum that is constant within bands).
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pinn_cli.record.spectrum import lowest_level
from pinn_cli.system.quantities import MOTION
from pinn_cli.training.doubts.force_doubts import ForceTerm, equation_columns, force_histories
from pinn_cli.training.doubts.sensor_doubts import SensorTerm
from pinn_cli.training.factors.channel_at_point import ChannelAtPoint
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_equations import NormalEquations

# Bands are this much wider than high, but have so many residuals of every sensor.
BAND_RATIO, FEWEST_IN_BAND = 1.25, 16
# No band is taken to be less noisy than the noisiest one by more than this (variance).
QUIETEST = 1e-12
# A channel's power over that of its noise from which on a band tells of the motion.
SIGNAL = 10.0
# Share of the power of a coordinate's velocity in the bands where it moves.
MOVING = 0.95
# Rounds of weighted least squares at most, and the change of minus the logarithm that ends them.
WEIGHTED_ROUNDS, WEIGHTED_SETTLED = 8, 0.01
# Added to the diagonal of scaled normal equations: columns may be the same.
SINGULAR = 1e-13


@dataclass(frozen=True, eq=False)
class Fit:
    """The most probable value of some columns.

    Attributes:
        step: (W,), of every column; 0 of those that are held.
        energy: (bands,), what it leaves.
        minus_log: Minus the logarithm of the record's probability.
        information: (W,), of every column with the others that are free projected out; 0 of those that are held.
    """

    step: np.ndarray
    energy: np.ndarray
    minus_log: float
    information: np.ndarray

    def gain(self, before: Fit, place: int) -> float:
        """Logarithm of how many times as probable the record is as with one column less, less what its prior costs."""
        return before.minus_log - self.minus_log - 0.5 * float(np.log(max(self.information[place], 1.0)))


@dataclass(frozen=True, eq=False)
class LeftSpectra:
    """Products, band by band, of the residual and W columns, all with the motion projected out.

    Attributes:
        gram: (bands, 1 + W, 1 + W), the residual first.
        freedom: (bands,), how many values each has.
        precision: (W, W), of the columns' prior.
        pull: (W,), its slope.
        moving: (bands,) bool, where the structure moves.
    """

    gram: np.ndarray
    freedom: np.ndarray
    precision: np.ndarray
    pull: np.ndarray
    moving: np.ndarray

    def fit(self, free: Sequence[int], start: np.ndarray) -> Fit:
        """With some columns free; ``start`` (bands,) is the energy to begin with."""
        at = np.array(free, dtype=int)
        gram, prior, energy = self.gram[:, 1 + at][:, :, 1 + at], self.precision[np.ix_(at, at)], start
        across, x, inverse = self.gram[:, 1 + at, 0], np.zeros(len(at)), np.zeros((len(at), len(at)))
        minus_log = np.inf
        for _ in range(WEIGHTED_ROUNDS):
            weight = self.freedom / np.maximum(energy, QUIETEST * energy.max())
            inverse = _inverse(np.einsum("b,bij->ij", weight, gram) + prior)
            x = -inverse @ (weight @ across + self.pull[at])
            coefficients = np.concatenate(([1.0], x))
            kept = np.concatenate(([0], 1 + at))
            energy = (self.gram[:, kept][:, :, kept] @ coefficients) @ coefficients
            last, minus_log = minus_log, self._minus_log(energy) + float((0.5 * x @ prior + self.pull[at]) @ x)
            if abs(last - minus_log) < WEIGHTED_SETTLED:
                break
        step, information = np.zeros(len(self.pull)), np.zeros(len(self.pull))
        step[at], information[at] = x, 1.0 / np.maximum(np.diag(inverse), 1e-300)
        return Fit(step, energy, minus_log, information)

    def minus_log_after(self, step: np.ndarray) -> float:
        """Minus the logarithm of the record's probability with values of the columns from elsewhere."""
        coefficients = np.concatenate(([1.0], step))
        return self._minus_log((self.gram @ coefficients) @ coefficients)

    def _minus_log(self, energy: np.ndarray) -> float:
        return 0.5 * float(self.freedom @ np.log(np.maximum(energy, QUIETEST * energy.max())))

    @property
    def energy(self) -> np.ndarray:
        """(bands,), of the solution as it is."""
        return self.gram[:, 0, 0]


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Of a positive definite one, whatever its columns' sizes."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * np.outer(scale, scale)
    inverse: np.ndarray = np.linalg.inv(scaled + SINGULAR * np.eye(len(scale))) * np.outer(scale, scale)
    return inverse


def bands_of(length: float, highest: float) -> np.ndarray:
    """Edges, Hz, of bands of a record so long, s."""
    edges, least = [0.75 / length], FEWEST_IN_BAND * (0.5 / length)
    while edges[-1] < highest:
        edges.append(max(edges[-1] * BAND_RATIO, edges[-1] + least))
    edges[-1] = highest
    if len(edges) > 2 and edges[-1] - edges[-2] < least:
        del edges[-2]
    return np.array(edges)


def banded_gram(histories: np.ndarray, step: float, edges: np.ndarray) -> np.ndarray:
    """Products of histories (J, K), sampled evenly, s, in every band: (bands, K, K). Their means count nowhere."""
    from scipy.fft import dct

    cosines = dct(histories, type=2, norm="ortho", axis=0)
    frequency = 0.5 * np.arange(len(histories)) / (len(histories) * step)
    places = np.searchsorted(frequency, edges)
    return np.stack([cosines[a:b].T @ cosines[a:b] for a, b in itertools.pairwise(places)])


def left_spectra(
    equations: NormalEquations,
    point: Point,
    noise: NoiseModel,
    channels: Sequence[ChannelAtPoint],
    terms: tuple[Sequence[ForceTerm], Sequence[SensorTerm]],
    moved: np.ndarray,
    believed: np.ndarray,
    part: tuple[float, float],
) -> LeftSpectra:
    """Of the parameters and of forces and of what sensors may show, in this order.

    Args:
        equations: Of the record.
        point: Their solution.
        noise: Its weights.
        channels: Of the record.
        terms: Columns beside the parameters.
        moved: (size, 1 + W), how the motion moves with the residual, and with one of every column.
        believed: (p, p), precision of the parameters' prior.
        part: Of the record that is looked at, from and to, of its duration.
    """
    p, (forces, sensors) = len(point.parameters), terms
    length = equations.problem.record.duration * (part[1] - part[0])
    enforced = torch.nonzero(equations.target.equation).flatten().tolist()
    smooth = range(equations.dynamics.smooth.start, equations.dynamics.smooth.stop)
    edges = _edges(equations, length)
    time = equations.target.physics_time
    of_equations = _of_equations(equations, point, noise, forces, moved)
    step = 1.0 / equations.network.free_intervals if equations.averages is not None else float(time[1] - time[0])
    columns = moved.shape[1] - 1
    gram: np.ndarray = np.zeros((len(edges) - 1, 1 + columns, 1 + columns))
    # The process behind an input is a prior, and no measure of what the model leaves out: its level stays.
    prior = np.zeros((1 + columns, 1 + columns))
    for function in enforced:
        products = banded_gram(_part(of_equations.pop(function), part), step, edges)
        if function in smooth:
            prior += products.sum(axis=0)
        else:
            gram += products
    for histories, channel_step in _of_channels(equations, channels, sensors, moved, p + len(forces)):
        gram += banded_gram(_part(histories, part), channel_step, edges)
    prior[1:, 1:] += np.eye(columns)
    prior[1 : 1 + p, 1 : 1 + p] += believed - np.eye(p)
    prior[1 : 1 + p, 0] += believed @ point.parameters.numpy()
    values = len(enforced) - len(smooth) + len(channels) - equations.dynamics.size
    freedom = max(values, 1) * 2.0 * length * np.diff(edges)
    seen, moving = _seen(channels, edges), _moving(equations, point, edges)
    return LeftSpectra(gram[seen], freedom[seen], prior[1:, 1:], prior[1:, 0], moving[seen])


def highest_seen(equations: NormalEquations, channels: Sequence[ChannelAtPoint]) -> float:
    """Frequency, Hz, up to which some response sensor shows more of the motion than noise."""
    edges = _edges(equations, equations.problem.record.duration)
    return float(edges[1:][_seen(channels, edges)][-1])


def _edges(equations: NormalEquations, length: float) -> np.ndarray:
    """Of the bands of a part of the record so long, s."""
    highest = 0.5 * min(equations.network.free_intervals, 1.0 / equations.problem.record.step)
    return bands_of(length, highest)


def _part(histories: np.ndarray, part: tuple[float, float]) -> np.ndarray:
    first, last = np.rint(np.array(part) * len(histories)).astype(int).tolist()
    return histories[first:last]


def _of_equations(
    equations: NormalEquations,
    point: Point,
    noise: NoiseModel,
    forces: Sequence[ForceTerm],
    moved: np.ndarray,
) -> dict[int, np.ndarray]:
    """Whitened histories (J, 1 + W) of every equation that is enforced."""
    p, residual = len(point.parameters), equations.motion.residual(point)
    histories, distribution = force_histories(equations, forces)
    root = equations.motion.weight(noise).sqrt()
    by_function: defaultdict[int, list[Tensor]] = defaultdict(list)
    for part, function, rows, by in equation_columns(equations, point):
        columns = torch.as_tensor(rows @ moved).to(residual).unflatten(0, by.shape[:2])
        columns[..., 0] += residual[part][..., function]
        columns[..., 1 : 1 + p] += by
        forced = np.flatnonzero(distribution[function])
        columns[..., 1 + p + forced] += histories[part][..., forced] * torch.as_tensor(
            distribution[function, forced]
        ).to(histories)
        columns *= (root if root.ndim == 1 else root[part])[..., function, None]
        by_function[function].append(columns)
    even = equations.physics.scatter if equations.averages is None else equations.averages.by_interval
    return {function: even(torch.cat(by_function.pop(function))).numpy() for function in list(by_function)}


def _of_channels(
    equations: NormalEquations,
    channels: Sequence[ChannelAtPoint],
    sensors: Sequence[SensorTerm],
    moved: np.ndarray,
    before: int,
) -> Iterator[tuple[np.ndarray, float]]:
    """The same of every channel; ``before`` columns are not of sensors."""
    for i, channel in enumerate(channels):
        histories = channel.moved(equations.layout, moved)
        histories[:, 0] += channel.residual
        for place, by in channel.parameters.items():
            histories[:, 1 + place] += by
        for j, term in enumerate(sensors):
            if i in term.shown:
                histories[:, 1 + before + j] += term.shown[i]
        histories *= np.broadcast_to(channel.counted, len(histories))[:, None] / channel.sigma
        yield histories, float(np.median(np.diff(channel.time)))


def _seen(channels: Sequence[ChannelAtPoint], edges: np.ndarray) -> np.ndarray:
    """(bands,) bool: where some response sensor shows more of the motion than noise.

    Elsewhere an estimate that follows its sensors moves as their noise does, and so do its columns: what they explain
    of the discrepancy there is that noise.
    """
    seen = np.zeros(len(edges) - 1, bool)
    for channel in channels:
        if channel.quantity not in MOTION:
            continue
        shown, step = channel.gain * channel.measurand - channel.residual, float(np.median(np.diff(channel.time)))
        values = 2.0 * len(shown) * step * np.diff(edges)
        power = banded_gram(shown[:, None], step, edges)[:, 0, 0] / values
        seen |= power > SIGNAL * lowest_level(shown, step) ** 2
    return seen if seen.any() else ~seen


def _moving(equations: NormalEquations, point: Point, edges: np.ndarray) -> np.ndarray:
    """(bands,) bool: where nearly all of the velocity of any coordinate is."""
    velocity = equations.flat_states(equations.observation, point).velocity[:, : equations.dynamics.ndof].numpy()
    power = np.einsum("bii->bi", banded_gram(velocity, equations.problem.record.step, edges))
    density = power / np.diff(edges)[:, None]
    order = np.argsort(-density, axis=0)
    ranked = np.take_along_axis(power, order, axis=0)
    inside = np.cumsum(ranked, axis=0) - ranked < MOVING * ranked.sum(axis=0)
    by_coordinate = np.zeros_like(inside)
    np.put_along_axis(by_coordinate, order, inside, axis=0)
    moving: np.ndarray = by_coordinate.any(axis=1)
    return moving
